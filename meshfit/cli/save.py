"""`meshfit save`: the result of a trial in any mesh format."""

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from meshfit.cli import completions
from meshfit.cli.console import err, out, print_warning
from meshfit.cli.options import DEFAULT_RUNS, OutputFormat, Runs, TrialName, suggest_option
from meshfit.errors import ConfigError, StoreError
from meshfit.paths import STDOUT_PATHS, path_text
from meshfit.units import count_text

if TYPE_CHECKING:
    from meshfit.experiment.status.scan import ScannedTrial
    from meshfit.experiment.storage.run_directory import Result
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.point_cloud import PointCloud
    from meshfit.mesh.polygons import PolygonMesh

_MESHES = {"result": "result.ply", "source": "source.ply", "control": "control.ply"}
_NOTICED = 1e-5
"""Rounding that is warned of, as a share of the mesh's size."""


def save(
    trial: TrialName,
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            help="File to write; its suffix names the format, which may be compressed, as in x.ply.gz. - is standard "
            "output.",
            metavar="OUT",
            autocompletion=completions.meshes,
        ),
    ],
    what: Annotated[
        Literal["result", "source", "control", "target"],
        typer.Option(
            "--what",
            help="Mesh to write: result, source, control (the control mesh, where one was fitted) or target (as it was "
            "loaded).",
            metavar="MESH",
        ),
    ] = "result",
    frame: Annotated[
        Literal["target", "normalised"],
        typer.Option(
            "--frame",
            help="Coordinates: target, with the unit of the target's file, or normalised, those of all lengths in "
            "tables.",
            metavar="FRAME",
        ),
    ] = "target",
    output_format: OutputFormat = None,
    runs: Runs = DEFAULT_RUNS,
) -> int:
    """Write the result of a trial in any mesh format.

    It is in the frame of the target's file, so that it lies on the target and has its unit, whatever the frame of the
    files in the trial's folder. It has the texture coordinates, colours and groups of the trial's source, and its
    materials and skin, as long as the file of the source is there.

    Examples:
        meshfit save runs/table1/bunny/loop/seed-0-* -o bunny.obj
        meshfit save 3f9a -o result.glb  # the trial of this identity
        meshfit save 3f9a --what target --frame normalised -o target.ply
        meshfit save 3f9a -o - --output-format stl | gzip > result.stl.gz
    """
    from meshfit.experiment.status.scan import find_trial
    from meshfit.mesh.io.files import mesh_output_suffix, save_mesh
    from meshfit.mesh.io.point_clouds import save_point_cloud
    from meshfit.mesh.point_cloud import PointCloud

    with suggest_option("--output-format"):
        suffix = mesh_output_suffix(output, output_format)
    _, scanned = find_trial(trial, runs, datetime.now(UTC))
    mesh = _read(scanned, _record(scanned), what, frame)
    if isinstance(mesh, PointCloud):
        save_point_cloud(mesh, output, file_format=output_format)
    else:
        save_mesh(mesh, output, file_format=output_format)
    console, name = (err, "standard output") if output in STDOUT_PATHS else (out, path_text(output))
    _warn_of_rounding(mesh, suffix, name)
    where = "in the frame of the target's file" if frame == "target" else "in the normalised frame"
    counts = f"{count_text(mesh.num_verts, 'vertex')}, {count_text(mesh.num_faces, 'face')}"
    if isinstance(mesh, PointCloud):
        counts = count_text(mesh.num_verts, "point")
    console.print(f"wrote {name}: {what} of {scanned.label}, {counts}, {where}", soft_wrap=True, markup=False)
    return 0


def _record(trial: "ScannedTrial") -> "Result":
    """The record of a complete trial; one that is not names the mesh that there is instead."""
    from meshfit.experiment.storage.run_directory import read_result
    from meshfit.experiment.trial_status import TrialStatus

    result = read_result(trial.path)
    if result is not None:
        return result
    state = "running" if trial.status is TrialStatus.RUNNING else trial.status.value
    raise ConfigError(f"{trial.label}: {state}, so it has no result; {_alternative(trial)}")


def _alternative(trial: "ScannedTrial") -> str:
    from meshfit.experiment.storage.checkpoint import snapshots_in
    from meshfit.experiment.storage.failure import LAST_GOOD

    if (path := trial.path / LAST_GOOD).is_file():
        return f"the mesh before it diverged is {path}"
    if snapshots := snapshots_in(trial.path):
        step, path = list(snapshots.items())[-1]
        return f"its latest snapshot, of step {step:,}, is {path}"
    return f"`meshfit show {trial.identity[:10]}` says more, and `meshfit run` completes it"


def _read(
    trial: "ScannedTrial", record: "Result", what: str, frame: Literal["target", "normalised"]
) -> "Mesh | PolygonMesh | PointCloud":
    """Read a mesh of a trial, in one of its frames."""
    from meshfit.experiment.storage.attributes import with_attributes
    from meshfit.experiment.storage.frame import frame_of, written_frame
    from meshfit.experiment.storage.mesh_files import check_mesh_file
    from meshfit.experiment.storage.run_directory import RESULT
    from meshfit.experiment.storage.targets import read_target, read_written_mesh

    mesh: Mesh | PolygonMesh | PointCloud
    try:
        map_of_trial, found = frame_of(record), written_frame(record)
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{trial.path / RESULT}: not the result of a trial: no {error} in its frame") from None
    if what == "target":
        mesh, found = read_target(trial.path, record), "target"
    else:
        path = trial.path / _MESHES[what]
        if what == "control" and not path.is_file():
            remedy = "fits with fit.variables: control write one"
            raise ConfigError(f"{trial.label}: no control mesh was fitted; {remedy}")
        check_mesh_file(path, record)
        mesh = with_attributes(read_written_mesh(path), path, record)
    if found == frame:
        return mesh
    return map_of_trial.restore(mesh) if frame == "target" else map_of_trial.normalise(mesh)


def _warn_of_rounding(mesh: "Mesh | PolygonMesh | PointCloud", suffix: str, name: str) -> None:
    """Warn where single precision is too coarse for a mesh far from the origin."""
    import numpy as np

    from meshfit.mesh.geometry import bounding_box_diagonal
    from meshfit.mesh.io.files import FORMATS
    from meshfit.mesh.io.recognition import format_name

    if FORMATS[suffix].double:
        return
    largest, size = float(np.abs(mesh.verts).max()), bounding_box_diagonal(mesh.verts)
    rounding = largest * 2.0**-24
    if rounding > _NOTICED * size:
        held = f"{format_name(suffix)} holds single precision, which rounds coordinates by up to {rounding:.2g}"
        share = f"{rounding / size:.1%} of the mesh's size" if rounding < size else "more than the mesh's size"
        print_warning(f"{name}: {held}, {share}; OBJ, PLY and OFF hold double precision")
