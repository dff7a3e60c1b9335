"""`meshfit measure`: measure one mesh against one target."""

import json
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.markup import escape
from rich.table import Table

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import AsJson, MeshFormat, RepairMode, Weld, suggest_option
from meshfit.errors import ConfigError
from meshfit.paths import MESH_SUFFIXES, STREAM, format_suffix, is_pipe

if TYPE_CHECKING:
    from meshfit.mesh.cleaning_options import CleaningOptions
    from meshfit.mesh.mesh import Mesh


def measure(
    result: Annotated[
        str,
        typer.Argument(
            help="Mesh file of the result; - is standard input.", metavar="RESULT", autocompletion=completions.targets
        ),
    ],
    target: Annotated[
        str,
        typer.Argument(
            help="Mesh file or name of the target; - is standard input.",
            metavar="TARGET",
            autocompletion=completions.targets,
        ),
    ],
    samples: Annotated[
        int | None,
        typer.Option(
            "--samples",
            min=100,
            help="Points sampled uniformly on each surface.",
            show_default="200000",
            metavar="N",
        ),
    ] = None,
    normalise: Annotated[
        Literal["tutorial", "box", "none"],
        typer.Option(
            "--normalise",
            help="Normalise both meshes by this frame of the target: tutorial, box or none.",
            metavar="FRAME",
        ),
    ] = "none",
    input_format: MeshFormat = None,
    weld: Weld = 0.0,
    repair: RepairMode = "split",
    as_json: AsJson = False,
) -> int:
    """Measure a mesh against a target.

    The metrics are Hausdorff, mean and RMS distance, chamfer distance, F-score, normal consistency and mesh quality.
    Lengths are in the files' own units unless --normalise names a frame.

    Examples:
        meshfit measure result.ply target.obj
        meshfit measure decimated.obj bunny --normalise tutorial --json
        zstdcat scan.ply.zst | meshfit measure - target.obj --format ply
    """
    from meshfit.measuring.measure import measure as measure_mesh
    from meshfit.measuring.settings import MeasureSettings
    from meshfit.mesh.cleaning_options import CleaningOptions
    from meshfit.mesh.normalisation import frame_of

    if result == target == STREAM:
        raise ConfigError("standard input can be only one of RESULT and TARGET")
    cleaning = CleaningOptions(weld, repair)
    result_mesh, target_mesh = (_load(name, cleaning, input_format) for name in (result, target))
    frame = frame_of(target_mesh.verts, normalise)
    settings = MeasureSettings() if samples is None else MeasureSettings(samples=samples)
    values = measure_mesh(frame.normalise(result_mesh), frame.normalise(target_mesh), settings).to_dict()
    if as_json:
        typer.echo(json.dumps({"result": result, "target": target, "normalise": normalise} | values, indent=2))
    else:
        out.print(_table(result, target, values))
    return 0


def _load(name: str, cleaning: "CleaningOptions", input_format: str | None) -> "Mesh":
    """Load a mesh; the format applies if the name does not tell it."""
    from meshfit.mesh.targets import NAMED_TARGETS, load_target, open_target

    if name in NAMED_TARGETS or (format_suffix(name) in MESH_SUFFIXES and not is_pipe(name)):
        return load_target(name, cleaning)
    with suggest_option("--format"):
        return load_target(name, cleaning, file=open_target(name, file_format=input_format))


def _table(result: str, target: str, values: dict[str, Any]) -> Table:
    from meshfit.measuring.metrics import MEASURED

    table = Table(box=None, pad_edge=False, title=f"{escape(result)} against {escape(target)}", title_justify="left")
    table.add_column("metric")
    table.add_column("value", justify="right", style="bold")
    for name, metric in MEASURED.items():
        group, _, key = name.partition(".")
        value = values[group][key]
        table.add_row(metric.title, str(value) if isinstance(value, bool) else format(value, metric.format))
    return table
