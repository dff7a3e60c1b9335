"""`meshfit measure`: measure meshes against a target."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from meshfit.cli import completions
from meshfit.cli.console import EXIT_FAILED, out, print_error
from meshfit.cli.measure_again import Again, MeasureChanges, MeasureJobs, measure_again, require_again
from meshfit.cli.measure_files import FileMeasurement, KnownPlaces, LandmarkPairs, MeasuredTarget, loader, measure_each
from meshfit.cli.measurements import Measured, json_object, print_measured, write_csv
from meshfit.cli.options import OUTPUT, AsJson, MeshFormat, RepairMode, Weld, split_metrics
from meshfit.errors import ConfigError
from meshfit.measuring.limits import Limit, parse_limit
from meshfit.measuring.metrics import CORRESPONDING, OF_MEASUREMENTS
from meshfit.mesh.placing_options import Normalisation
from meshfit.paths import MESH_SUFFIXES, STREAM, format_suffix, is_folder, path_text
from meshfit.specs import suggest

if TYPE_CHECKING:
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.point_cloud import PointCloud

LIMITS, TEMPLATES = "Limits", "Templates"

_WRITTEN = (".ply", ".vtp")
# Options that groups of metrics need, other than --source.
_OPTION_OF = {"vertex_error": "--truth", "landmark_error": "--landmarks"}
_UNSIGNED, _UNSIGNED_TO_POINTS = "unsigned, since the target is open", "unsigned, to the nearest points of the target"


def measure(
    meshes: Annotated[
        list[str],
        typer.Argument(
            help="The result, then the target: mesh files, names of targets, or - for standard input; the target may "
            "be a file of points, or a folder of images with cameras. With --target, all are results.",
            metavar="MESHES",
            autocompletion=completions.targets,
        ),
    ],
    target: Annotated[
        str | None,
        typer.Option(
            "--target",
            "-t",
            help="File or name of the target of all results, which become the rows of a table.",
            metavar="TARGET",
            autocompletion=completions.targets,
        ),
    ] = None,
    truth: Annotated[
        str | None,
        typer.Option(
            "--truth",
            help="File of a mesh or of points with the place where each vertex of the result belongs, in the frame of "
            "the target, for the vertex error.",
            metavar="FILE",
            rich_help_panel=TEMPLATES,
            autocompletion=completions.meshes,
        ),
    ] = None,
    landmarks: Annotated[
        str | None,
        typer.Option(
            "--landmarks",
            help="File of landmarks with their places on the source and on the target, for the landmark error: a CSV "
            "table, or a point list of 3D Slicer.",
            metavar="FILE",
            rich_help_panel=TEMPLATES,
        ),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(
            "--source",
            help="Mesh that was fitted, with the faces of the result, for stretch, new defects and the share without a "
            "partner; its pose does not matter.",
            metavar="FILE",
            rich_help_panel=TEMPLATES,
            autocompletion=completions.targets,
        ),
    ] = None,
    surface: Annotated[
        Literal["all", "outer"],
        typer.Option(
            "--surface",
            help="Surfaces to measure between: all of both meshes, or outer, what can be seen of them from outside, so "
            "that parts inside others do not count.",
            metavar="all|outer",
        ),
    ] = "all",
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
        Normalisation,
        typer.Option(
            "--normalise",
            help="Normalise all meshes by this frame of the target: tutorial, sphere, box, cube or none.",
            metavar="FRAME",
        ),
    ] = "none",
    tau: Annotated[
        str | None,
        typer.Option(
            "--tau",
            help="Distance within which points match in the F-scores; N% is of the target's diagonal.",
            show_default="0.5%; with --normalise, 0.01",
            metavar="DISTANCE",
        ),
    ] = None,
    crease_angle: Annotated[
        float | None,
        typer.Option(
            "--crease-angle",
            help="Least angle between the faces of a crease, in degrees.",
            show_default="30",
            metavar="ANGLE",
        ),
    ] = None,
    fail_above: Annotated[
        list[str] | None,
        typer.Option(
            "--fail-above",
            help="Exit 1 if a metric is above a number in the file's unit, or N% of the target's diagonal. "
            "May be repeated.",
            metavar="METRIC=NUMBER",
            rich_help_panel=LIMITS,
            autocompletion=completions.limits,
        ),
    ] = None,
    fail_below: Annotated[
        list[str] | None,
        typer.Option(
            "--fail-below",
            help="Exit 1 if a metric is below a number. May be repeated.",
            metavar="METRIC=NUMBER",
            rich_help_panel=LIMITS,
            autocompletion=completions.limits,
        ),
    ] = None,
    metrics: Annotated[
        list[str] | None,
        typer.Option(
            "--metric",
            help="Metric to show, or several: a,b. May be repeated.",
            show_default="all; for several results, a choice",
            metavar="NAME,...",
            rich_help_panel=OUTPUT,
            autocompletion=completions.listed_measured,
            callback=split_metrics,
        ),
    ] = None,
    write: Annotated[
        str | None,
        typer.Option(
            "--write",
            help="Write the result as .ply, or .vtp for ParaView and VTK, with the distance of each vertex and face, "
            "negative inside the target.",
            metavar="FILE",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    csv_file: Annotated[
        str | None,
        typer.Option(
            "--csv",
            help="Write CSV: a row per metric, or with --target a row per result; - is standard output.",
            metavar="FILE",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    as_json: AsJson = False,
    input_format: MeshFormat = None,
    weld: Weld = 0.0,
    repair: RepairMode = "split",
    again: Again = False,
    overrides: MeasureChanges = None,
    jobs: MeasureJobs = None,
) -> int:
    """Measure a mesh against a target.

    The metrics are Hausdorff, mean and RMS distance and percentiles, chamfer distance, F-score, agreement of normals
    and of creases, and mesh quality; with --truth and --source, vertex errors, stretch and new defects. Distances to a
    target of points are to the nearest of them, and thus too large by a share of their spacing; those from it are
    exact. Lengths are in the files' own units unless --normalise names a
    frame. Several results are measured with --target; one that cannot be is named, the others are measured, and the
    exit code is 1.

    A target of images gives the overlap of masks; distances are to the points of its depth maps, where it has some.

    With --again, complete trials of run directories are measured with other settings, without another fit. Tables,
    reports and exports then have the new values; those of the fit stay in result.json, and are back once
    measurement.json is deleted.

    Examples:
        meshfit measure result.ply target.obj
        meshfit measure animal.obj photos/  # images with cameras
        meshfit measure result.ply scan.stl --write errors.ply
        meshfit measure results/*.ply --target scan.stl --csv errors.csv
        meshfit measure skin.ply parts.obj --surface outer
        meshfit measure registered.obj scan.ply --source template.obj --truth known.ply
        meshfit measure result.ply points.xyz  # a cloud of points
        meshfit measure result.ply scan.stl --fail-above hausdorff=0.5%
        meshfit measure decimated.obj bunny --normalise tutorial --json
        zcat scan.ply.gz | meshfit measure - target.obj --format ply
        meshfit measure --again runs/table1 --set measure.samples=1000000
    """
    from meshfit.measuring.settings import MeasureSettings
    from meshfit.mesh.any_target import require_mesh
    from meshfit.mesh.cleaning_options import CleaningOptions
    from meshfit.mesh.geometry import bounding_box_diagonal
    from meshfit.mesh.normalisation import frame_of
    from meshfit.settings import override

    require_again(again, {"--set": overrides, "--jobs": jobs})
    if again:
        given_too = {
            "--target": target,
            "--truth": truth,
            "--landmarks": landmarks,
            "--source": source,
            "--weld": weld,
            "--metric": metrics,
            "--fail-above": fail_above,
            "--fail-below": fail_below,
            "--json": as_json,
            "--write": write,
            "--csv": csv_file,
            "--format": input_format,
        }
        changed = {
            "surface": None if surface == "all" else surface,
            "samples": samples,
            "crease_angle": crease_angle,
            "f_score_tau": None if tau is None else _tau(tau, normalise),
        }
        return measure_again(meshes, overrides or (), changed, given_too, jobs=jobs)
    results, target_name = _roles(meshes, target)
    limits = [parse_limit(text, above=True) for text in fail_above or ()] + [
        parse_limit(text, above=False) for text in fail_below or ()
    ]
    given = {"--truth": truth, "--landmarks": landmarks, "--source": source}
    _check_metrics(metrics, given)
    _check_metrics([limit.metric for limit in limits], given)
    _check_output([*results, target_name, *filter(None, given.values())], write, csv_file, as_json=as_json)
    if write is not None and len(results) > 1:
        raise ConfigError(f"--write takes one result, got {len(results)}; measure them one by one")
    options = {
        "surface": surface,
        "samples": samples,
        "crease_angle": crease_angle,
        "f_score_tau": _tau(tau, normalise),
    }
    settings = override(MeasureSettings(), {key: value for key, value in options.items() if value is not None})
    load = loader(CleaningOptions(weld, repair), input_format)
    goal = MeasuredTarget.read(target_name, load, [*(metrics or ()), *(limit.metric for limit in limits)])
    target_mesh = goal.shape
    frame = frame_of(target_mesh.verts, normalise)
    known = None if truth is None else KnownPlaces.read(truth, frame)
    start = None if source is None else frame.normalise(require_mesh(load(source), source))
    pairs = None if landmarks is None else LandmarkPairs.read(landmarks, source, target_name, target_mesh)
    normalised = frame.normalise(target_mesh)
    moved = None if goal.images is None else goal.images.moved(frame)
    measuring = FileMeasurement(load, frame, normalised, settings, write, target_name, known, pairs, start, moved)
    diagonal = bounding_box_diagonal(measuring.target.verts)
    if target is None:
        measured = [Measured(results[0], measuring.measure(results[0]))]
    else:
        measured = list(measure_each(measuring, results))
    about = {"target": target_name, "normalise": normalise, "surface": surface} | goal.about
    metrics = metrics or goal.metrics
    if csv_file is not None:
        write_csv(csv_file, measured, target_name, metrics, wide=target is not None)
    if as_json:
        typer.echo(json.dumps(json_object(measured, about, single=target is None), indent=2))
    elif csv_file != STREAM:
        print_measured(measured, target_name, metrics, diagonal, surface=surface, single=target is None)
        goal.print_note()
    if write is not None and not as_json and csv_file != STREAM:
        out.print(f"wrote {path_text(write)}: distances, {_side(measuring.target)}", soft_wrap=True, markup=False)
    failed = any(each.error for each in measured)
    for each in measured:
        for line in _failures(each, limits, diagonal):
            print_error(f"{path_text(each.result)}: {line}")
            failed = True
    return EXIT_FAILED if failed else 0


def _side(target: "Mesh | PointCloud") -> str:
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.topology import Topology

    if not isinstance(target, Mesh):
        return _UNSIGNED_TO_POINTS
    return "negative inside the target" if Topology.of(target).is_watertight else _UNSIGNED


def _roles(meshes: Sequence[str], target: str | None) -> tuple[list[str], str]:
    """Return the names of the results, and that of the target."""
    *results, last = meshes
    if target is not None:
        results, last = list(meshes), target
    elif not results:
        raise ConfigError(f"no target: give it after the result: meshfit measure {path_text(last)} TARGET")
    elif len(results) > 1:
        raise ConfigError(f"{len(meshes)} meshes without --target: give the target of several results by --target")
    if [*results, last].count(STREAM) > 1:
        raise ConfigError("standard input can be only one of RESULT and TARGET")
    return results, last


def _check_metrics(metrics: Sequence[str] | None, given: Mapping[str, str | None]) -> None:
    """Refuse a metric that there is not, or that needs an option that is not given."""
    for metric in metrics or ():
        if metric not in OF_MEASUREMENTS:
            raise ConfigError(f"'{metric}' is not a metric of a measurement: {suggest(metric, OF_MEASUREMENTS)}")
        if metric in CORRESPONDING:
            option = _OPTION_OF.get(metric.partition(".")[0], "--source")
            if given[option] is None:
                raise ConfigError(f"{metric} requires {option} FILE")


def _check_output(meshes: Sequence[str], write: str | None, csv_file: str | None, *, as_json: bool) -> None:
    """Refuse, before anything is measured, to write what cannot be written, or over one of the meshes."""
    if csv_file == STREAM and as_json:
        raise ConfigError("standard output can have only one of --csv - and --json")
    if write is not None and format_suffix(write) not in _WRITTEN:
        names = " or ".join(_WRITTEN)
        raise ConfigError(f"--write {path_text(write)}: distances are written as PLY or VTP; give a name in {names}")
    for option, path, example in (("--write", write, "errors.ply"), ("--csv", csv_file, "errors.csv")):
        if path is None or path == STREAM:
            continue
        named = f"{option} {path_text(path)}"
        if is_folder(path):
            raise ConfigError(f"{named}: a directory; give the path of a file, such as {example}")
        same = [mesh for mesh in meshes if mesh != STREAM and Path(mesh).resolve() == Path(path).resolve()]
        if same or (option == "--csv" and format_suffix(path) in MESH_SUFFIXES):
            why = "would overwrite a mesh that is measured" if same else "expected a name for CSV, got one for a mesh"
            raise ConfigError(f"{named}: {why}; give another name, such as {example}")


def _tau(text: str | None, normalise: str) -> float | str:
    """Return the distance of the F-scores as a setting; in a normalised frame, the default is that of experiments.

    Raises:
        ConfigError: neither a number above 0 nor a percentage.
    """
    from meshfit.measuring.settings import LENGTH_OR_SHARE, TAU_OF_FILES, MeasureSettings, share_of_diagonal

    if text is None:
        return TAU_OF_FILES if normalise == "none" else MeasureSettings().f_score_tau
    if share_of_diagonal(text) is not None:
        return text
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < math.inf:
        raise ConfigError(f"--tau {text}: expected {LENGTH_OR_SHARE}")
    return value


def _failures(measured: Measured, limits: Sequence[Limit], diagonal: float) -> list[str]:
    if measured.error:
        return []
    return [line for limit in limits if (line := limit.failure(measured.values, diagonal)) is not None]
