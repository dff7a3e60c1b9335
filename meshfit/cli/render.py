"""`meshfit render`: a picture of meshes, or of trials, side by side."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out

if TYPE_CHECKING:
    from meshfit.mesh.mesh import Mesh


def render(
    what: Annotated[
        list[str],
        typer.Argument(
            help="Mesh files, names of targets, or folders of trials; TITLE=… gives a title.",
            metavar="WHAT...",
            autocompletion=completions.meshes_or_trials,
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The PNG to write.", metavar="FILE")],
    edges: Annotated[bool, typer.Option("--edges", help="Draw the edges of faces too.")] = False,
) -> int:
    """Draw meshes, or trials, side by side.

    They are drawn from one view, y up, targets in their tutorial frame. The folder of a trial stands for its source,
    its result and its target. Needs the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit render bunny mousehead -o targets.png

        meshfit render runs/table1/bunny/loop/seed-0-* -o fit.png --edges
    """
    from meshfit.report.pictures import draw_row

    titled: dict[str, Mesh] = {}
    for text in what:
        title, _, name = text.rpartition("=")
        titled |= _trial(Path(name), title) if Path(name).is_dir() else _mesh(name, title)
    draw_row(titled, output, edges=edges)
    out.print(f"wrote {output}", soft_wrap=True, markup=False)
    return 0


def _mesh(name: str, title: str) -> dict[str, "Mesh"]:
    from meshfit.mesh.frames import frame_of
    from meshfit.mesh.targets import NAMED_TARGETS, load_target, target_title

    mesh = load_target(name)
    mesh = frame_of(mesh.verts, "tutorial").normalise(mesh) if name in NAMED_TARGETS else mesh
    return {title or target_title(name): mesh}


def _trial(folder: Path, title: str) -> dict[str, "Mesh"]:
    from meshfit.experiment.store import RESULT, read_json
    from meshfit.mesh.files import load_mesh
    from meshfit.mesh.frames import Frame
    from meshfit.mesh.targets import load_target

    result = read_json(folder / RESULT)
    frame = Frame(tuple(result["frame"]["centre"]), result["frame"]["scale"])
    target = load_target(result["settings"]["targets"][0])
    own = result["settings"]["write_frame"] == "target"
    name = title or result["scheme"]
    return {
        f"source, {name}": load_mesh(folder / "source.ply"),
        f"result, {name}": load_mesh(folder / "result.ply"),
        result["target_title"]: target if own else frame.normalise(target),
    }
