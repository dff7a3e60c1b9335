"""`meshfit fit`: fit meshes to targets, from file to file."""

import json
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import typer

from meshfit.cli import completions
from meshfit.cli.console import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_USAGE, err, working
from meshfit.cli.fit_command import is_config_name
from meshfit.cli.fit_jobs import FitJobs
from meshfit.cli.fit_outputs import (
    check_not_overwritten,
    check_output,
    check_printed,
    correspondence_files,
    outputs_of_many,
)
from meshfit.cli.fit_plan import FitOptions, check_options, parse_keep, parse_noise, parse_position
from meshfit.cli.options import (
    EXECUTION,
    OUTPUT,
    SELECTION,
    AsJson,
    MeshFormat,
    OutputFormat,
    Quiet,
    RepairMode,
    RunOptions,
    Weld,
    suggest_option,
)
from meshfit.cli.scratch import scratch_folder
from meshfit.errors import ConfigError
from meshfit.images.specs import is_image_target
from meshfit.paths import (
    STDOUT_PATHS,
    STREAM,
    is_folder,
    is_pipe,
    path_text,
    shell_path,
)
from meshfit.units import count_text

_FIT, TEMPLATES, SCANS = "Fit", "Templates", "Scans"


def fit(
    targets: Annotated[
        list[str],
        typer.Argument(
            help="Files of meshes or points, names of targets, or folders of images with cameras; - is standard input.",
            metavar="TARGET",
            autocompletion=completions.targets,
        ),
    ],
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            help="File to write, whose suffix names the format, or - for standard output; for several targets, a "
            "folder, which is created.",
            metavar="OUT",
            autocompletion=completions.meshes,
        ),
    ],
    verts: Annotated[
        int | None,
        typer.Option(
            "--verts",
            min=100,
            help="Largest number of vertices; with --connectivity fixed, about their number.",
            show_default="10242",
            metavar="N",
            rich_help_panel=_FIT,
        ),
    ] = None,
    scheme: Annotated[
        str,
        typer.Option(
            "--scheme",
            "-s",
            help="Subdivision scheme; see `meshfit schemes`.",
            metavar="SCHEME",
            rich_help_panel=_FIT,
            autocompletion=completions.schemes,
        ),
    ] = "loop",
    levels: Annotated[
        int | None,
        typer.Option(
            "--levels",
            "-n",
            min=0,
            max=5,
            help="Subdivision levels of the fit, from coarse to fine.",
            show_default="1; 0 for the faces of a file",
            metavar="N",
            rich_help_panel=_FIT,
        ),
    ] = None,
    connectivity: Annotated[
        Literal["remeshed", "fixed"],
        typer.Option(
            "--connectivity",
            help="Faces of the result: remeshed adapts them to the target, fixed keeps those of the source.",
            metavar="MODE",
            rich_help_panel=_FIT,
        ),
    ] = "remeshed",
    source: Annotated[
        str,
        typer.Option(
            "--source",
            help="Mesh to start from: target, the target with few faces; closed, the same with its holes filled; wrap, "
            "one closed surface around it; open, an open one through points; hull, the visual hull of images; auto, "
            "one of these; sphere, a small one inside it; or a mesh file.",
            metavar="auto|target|closed|open|wrap|hull|sphere|FILE",
            rich_help_panel=_FIT,
            autocompletion=completions.targets,
        ),
    ] = "auto",
    register: Annotated[
        Literal["auto", "rigid", "near-rigid", "soft", "off"] | None,
        typer.Option(
            "--register",
            help="Register --source, a template each of whose vertices has a meaning: rigid finds its pose, near-rigid "
            "also bends it, so that ears go to ears, and soft lets its parts grow and shrink, too, as from animal to "
            "animal; auto chooses between the first two, and says what; off fits it from where it is. All but off keep "
            "its faces.",
            show_default="auto for a file with --connectivity fixed, else off",
            metavar="auto|rigid|near-rigid|soft|off",
            rich_help_panel=_FIT,
        ),
    ] = None,
    landmarks: Annotated[
        str | None,
        typer.Option(
            "--landmarks",
            help="Landmarks of --source, with where they belong, or with names that --target-landmarks has too: "
            "CSV, .fcsv, .mrk.json, or MeshMonk's x,y,z rows.",
            metavar="FILE",
            rich_help_panel=TEMPLATES,
        ),
    ] = None,
    target_landmarks: Annotated[
        str | None,
        typer.Option(
            "--target-landmarks",
            help="Landmarks on the target, by name; of several targets, with {target} in its name for theirs.",
            metavar="FILE",
            rich_help_panel=TEMPLATES,
        ),
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(
            "--weights",
            help="Confidence in the data at each vertex of --source, 0 or more: vertex data in its file, or a text "
            "file with one number per line.",
            metavar="NAME|FILE",
            rich_help_panel=TEMPLATES,
        ),
    ] = None,
    fixed: Annotated[
        str | None,
        typer.Option(
            "--fixed",
            help="Vertices of --source that stay where they are, other than 0: as --weights.",
            metavar="NAME|FILE",
            rich_help_panel=TEMPLATES,
        ),
    ] = None,
    rigid: Annotated[
        str | None,
        typer.Option(
            "--rigid",
            help="Labels above 0 of vertices of --source that move rigidly, part by part: as --weights.",
            metavar="NAME|FILE",
            rich_help_panel=TEMPLATES,
        ),
    ] = None,
    symmetric: Annotated[
        bool,
        typer.Option(
            "--symmetric",
            help="Keep --source mirror-symmetric: each vertex of the result is the mirror image of its partner.",
            rich_help_panel=TEMPLATES,
        ),
    ] = False,
    offset: Annotated[
        float | None,
        typer.Option(
            "--offset",
            help="Distance of the result from the target, in the unit of its file: above 0 outside it, as skin "
            "is over bone.",
            metavar="LENGTH",
            rich_help_panel=TEMPLATES,
        ),
    ] = None,
    correspondence: Annotated[
        Path | None,
        typer.Option(
            "--correspondence",
            help="CSV file to write, with the target's face and barycentric coordinates, or its point, nearest to each "
            "vertex of the result; requires --register or --connectivity fixed. For several targets, a folder.",
            metavar="FILE",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            "--noise",
            help="Standard deviation of the target's points across its surface, in the unit of the file: the more, the "
            "smoother the result; 0 follows every point.",
            show_default="auto, an estimate",
            metavar="auto|LENGTH",
            rich_help_panel=SCANS,
        ),
    ] = None,
    direction: Annotated[
        Literal["both", "to-target", "to-source"] | None,
        typer.Option(
            "--direction",
            help="Pairs of points that pull: both; to-target, from the surface to the target; or to-source, from the "
            "target to the surface, for scans that show only a part.",
            show_default="both",
            metavar="WAY",
            rich_help_panel=SCANS,
        ),
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(
            "--sensor",
            help="Position that points without normals were scanned from, in the frame and unit of the file.",
            show_default="normals point outwards, from neighbour to neighbour",
            metavar="X,Y,Z",
            rich_help_panel=SCANS,
        ),
    ] = None,
    surface: Annotated[
        Literal["all", "outer"],
        typer.Option(
            "--surface",
            help="Surface to fit to: all of the target, or outer, what can be seen of it from outside, as one skin "
            "without the parts inside.",
            metavar="all|outer",
            rich_help_panel=_FIT,
        ),
    ] = "all",
    keep_pieces: Annotated[
        str,
        typer.Option(
            "--keep-pieces",
            help="Pieces of the target that count: all; largest, without the floaters of a scan; or those of at least "
            "a share of the largest, such as 0.1.",
            metavar="all|largest|SHARE",
            rich_help_panel=SCANS,
        ),
    ] = "all",
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=2**32 - 1, help="Seed.", metavar="N", rich_help_panel=_FIT)
    ] = 0,
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Change another setting of the config `accurate`. May be repeated.",
            metavar="KEY=VALUE",
            rich_help_panel=SELECTION,
            autocompletion=completions.settings,
        ),
    ] = None,
    device: Annotated[
        str | None,
        typer.Option(
            "--device",
            help="Device: auto, cpu, cuda, cuda:N or mps.",
            show_default="cpu",
            metavar="DEVICE",
            rich_help_panel=EXECUTION,
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            min=1,
            help="Fits that run in parallel on the CPU.",
            show_default="one per core",
            metavar="N",
            rich_help_panel=EXECUTION,
        ),
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option(
            "--keep",
            help="Run directory for the whole trial, for `meshfit show`, `report` and `table`; one that is complete "
            "there is not fitted again.",
            metavar="DIR",
            rich_help_panel=OUTPUT,
            autocompletion=completions.folders,
        ),
    ] = None,
    measure: Annotated[
        bool, typer.Option("--measure", help="Print all metrics, as `meshfit measure` does.", rich_help_panel=OUTPUT)
    ] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
    input_format: MeshFormat = None,
    output_format: OutputFormat = None,
    weld: Weld = 0.0,
    repair: RepairMode = "split",
) -> int:
    """Fit a mesh to a target, from file to file.

    The result lies on the target, in its frame and unit. The fit is that of the config `accurate`: from the target
    itself with few faces, so that its pieces, handles and openings are kept, or from a wrap around a soup of faces or a
    cloud of points, with or without normals. It
    ends with a verdict: distances, soundness, size and time.

    Texture coordinates, colours, materials and skin weights of a --source file survive: as they are with its own faces
    (--connectivity fixed), otherwise projected. With its own faces it is a template, and registered: it may be in any
    unit and at any place, and bends until each vertex is where it belongs.

    Several targets are fitted side by side; one that fails is named, the others go on, and the exit code is 1.

    Examples:
        meshfit fit bunny -o fitted.obj
        meshfit fit scan.stl -o fitted.ply --verts 40000 --measure
        meshfit fit parts.obj -o skin.glb --surface outer  # one skin, without what lies inside
        meshfit fit points.xyz -o surface.ply  # a cloud of points
        meshfit fit photos/ -o animal.obj  # images with masks, and their transforms.json
        meshfit fit head.obj -o head-fitted.obj --source sphere --connectivity fixed
        meshfit fit scan.ply -o registered.glb --source template.glb --connectivity fixed  # keeps its texture
        meshfit fit scan.ply -o moved.obj --source template.obj --register rigid
        meshfit fit scan.ply -o registered.obj --source template.obj --landmarks pairs.csv
        meshfit fit scan.ply -o fitted.obj --source template.obj --connectivity fixed --correspondence pairs.csv
        meshfit fit scans/*.obj -o fitted/ --output-format obj --jobs 4
        zcat scan.ply.gz | meshfit fit - --format ply -o fitted.ply
    """
    started = time.monotonic()
    from meshfit.mesh.cleaning_options import CleaningOptions

    many = len(targets) > 1 or (output not in STDOUT_PATHS and (is_folder(output) or output.endswith(("/", os.sep))))
    _check_targets(targets)
    outputs = outputs_of_many(targets, output, output_format) if many else [output]
    if not many:
        with suggest_option("--output-format"):
            check_output(output, output_format)
    check_printed(output, measure=measure, as_json=as_json)
    if measure and any(target == STREAM or is_pipe(target) for target in targets):
        raise ConfigError("--measure reads the target again, and a pipe can be read only once; use --json")
    check_not_overwritten(targets, outputs, source)
    guidance = {"landmarks": landmarks, "weights": weights, "fixed": fixed, "rigid": rigid}
    _check_landmarks(landmarks, target_landmarks, targets)
    options = FitOptions(
        verts=verts,
        scheme=scheme,
        levels=levels,
        connectivity="fixed" if register not in {None, "off"} or any(guidance.values()) or symmetric else connectivity,
        source=source,
        register=register,
        surface=surface,
        keep_pieces=parse_keep(keep_pieces),
        seed=seed,
        device=device,
        sensor=None if sensor is None else parse_position("--sensor", sensor),
        noise=None if noise is None else parse_noise(noise),
        direction=direction,
        guidance={key: value for key, value in guidance.items() if value is not None},
        target_landmarks=target_landmarks,
        symmetric=symmetric,
        offset=offset,
        cleaning=CleaningOptions(weld, repair),
        overrides=overrides or (),
    )
    check_options(options)
    tables = correspondence_files(correspondence, [*targets, source], outputs, options, many=many)
    run_options = RunOptions(jobs=jobs, quiet=quiet, as_json=as_json)
    try:
        with _folder(keep) as folder:
            fitting = FitJobs(options, folder, run_options, output_format, keep is not None, started)
            with working(f"reading {count_text(len(targets), 'mesh')}", quiet=quiet):
                jobs_of = fitting.plan(targets, outputs, tables, input_format, many=many)
            verdicts = fitting.run(jobs_of, many=many)
    except KeyboardInterrupt:
        if keep is not None:  # the same command resumes it
            raise
        err.print("interrupted; unfinished results were not written", style="bold magenta")
        raise SystemExit(EXIT_INTERRUPTED) from None
    if as_json:
        plain = [verdict.to_dict() | {"metrics": metrics} for verdict, metrics in verdicts]
        if many or plain:
            typer.echo(json.dumps(plain if many else plain[0], indent=2))
    elif measure:
        from meshfit.cli.measure import measure as print_metrics

        for verdict, _ in verdicts:
            print_metrics([verdict.output, verdict.target], surface=surface, weld=weld, repair=repair)
    if many and len(verdicts) < len(targets):
        err.print(f"fitted {len(verdicts)} of {count_text(len(targets), 'target')}", soft_wrap=True, markup=False)
    return EXIT_USAGE if not jobs_of else EXIT_FAILED if len(verdicts) < len(targets) else 0


def _check_landmarks(landmarks: str | None, target_landmarks: str | None, targets: Sequence[str]) -> None:
    if target_landmarks is not None and landmarks is None:
        raise ConfigError("--target-landmarks: gives places of the names in --landmarks; give that too")
    if target_landmarks is not None and len(targets) > 1 and "{target}" not in target_landmarks:
        raise ConfigError("--target-landmarks: of several targets, give each its own, as in 'landmarks/{target}.csv'")


def _check_targets(targets: Sequence[str]) -> None:
    """Refuse what is no mesh but something else of meshfit, and name the command for it."""
    for target in targets:
        if is_config_name(target):
            command = f"meshfit run {shell_path(target)}"
            raise ConfigError(f"{path_text(target)} is a config, not a mesh; to run it: {command}")
        if is_folder(target) and not is_image_target(target):
            command = f"meshfit fit {shell_path(target.rstrip('/'))}/* -o fitted/"
            raise ConfigError(f"{path_text(target)} is a folder, not a mesh; to fit the meshes in it: {command}")


@contextmanager
def _folder(keep: Path | None) -> Iterator[Path]:
    """The run directory: a given one, or one that is removed at the end."""
    from meshfit.experiment.storage.run_directory import make_folder

    if keep is not None:
        make_folder(keep)
        yield keep
        return
    with scratch_folder() as folder:
        yield folder
