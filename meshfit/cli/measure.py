"""`meshfit measure`: distances and soundness of one result against one target."""

import json
from enum import StrEnum
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import AsJson


class Normalisation(StrEnum):
    """What `meshfit.mesh.normalisation.Normalisation` allows, as Typer wants it."""

    TUTORIAL = "tutorial"
    BOX = "box"
    NONE = "none"


def measure(
    result: Annotated[
        str, typer.Argument(help="Mesh file of the result.", metavar="RESULT", autocompletion=completions.targets)
    ],
    target: Annotated[
        str,
        typer.Argument(help="Mesh file or name of the target.", metavar="TARGET", autocompletion=completions.targets),
    ],
    samples: Annotated[
        int | None,
        typer.Option(
            "--samples", min=100, help="Area-uniform points on each surface.", show_default="200000", metavar="N"
        ),
    ] = None,
    normalise: Annotated[
        Normalisation,
        typer.Option(
            "--normalise", help="Frame of the target that both are put in: tutorial, box or none.", metavar="FRAME"
        ),
    ] = Normalisation.NONE,
    as_json: AsJson = False,
) -> int:
    """Measure a mesh against a target.

    Hausdorff, mean and RMS distance, chamfer distance, F-score, normals, and whether the mesh is sound. Lengths
    are in the files' own units unless --normalise names a frame; the frame is always that of the target.

    Examples:
        meshfit measure result.ply target.obj

        meshfit measure decimated.obj bunny --normalise tutorial --json
    """
    from meshfit.measuring.measure import measure as measured
    from meshfit.measuring.settings import MeasureSettings
    from meshfit.mesh.normalisation import frame_of
    from meshfit.mesh.targets import load_target

    meshes = load_target(result), load_target(target)
    frame = frame_of(meshes[1].verts, normalise.value)
    settings = MeasureSettings() if samples is None else MeasureSettings(samples=samples)
    figures = measured(frame.normalise(meshes[0]), frame.normalise(meshes[1]), settings).to_dict()
    if as_json:
        typer.echo(json.dumps({"result": result, "target": target, "normalise": normalise.value} | figures, indent=2))
    else:
        out.print(_table(result, target, figures))
    return 0


def _table(result: str, target: str, figures: dict[str, Any]) -> Table:
    from meshfit.measuring.metrics import MEASURED

    table = Table(box=None, pad_edge=False, title=f"{escape(result)} against {escape(target)}", title_justify="left")
    table.add_column("metric")
    table.add_column("value", justify="right", style="bold")
    for name, metric in MEASURED.items():
        group, _, key = name.partition(".")
        value = figures[group][key]
        table.add_row(metric.title, str(value) if isinstance(value, bool) else format(value, metric.format))
    return table
