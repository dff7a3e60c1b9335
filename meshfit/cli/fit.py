"""`meshfit fit`: fit meshes to targets, from file to file."""

import json
import math
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryFile, mkdtemp
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from meshfit.cli import completions
from meshfit.cli.console import EXIT_FAILED, EXIT_INTERRUPTED, err, out, print_error, warn_once, working
from meshfit.cli.fit_command import is_config_name
from meshfit.cli.fit_plan import FitOptions, check_options, plan_fit
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
from meshfit.errors import ConfigError, MeshError, MeshfitError
from meshfit.images.specs import is_image_target, label_of_target
from meshfit.paths import (
    MESH_SUFFIXES,
    STDOUT_PATHS,
    STREAM,
    file_stem,
    format_suffix,
    is_folder,
    is_pipe,
    path_text,
    shell_path,
)
from meshfit.units import count_text

if TYPE_CHECKING:
    from meshfit.cli.verdict import Verdict
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.storage.run_directory import RunDirectory
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.polygons import PolygonMesh

_FIT, TEMPLATES, SCANS = "Fit", "Templates", "Scans"
_FORMAT_OF_MANY = "ply"
_INPUTS, _DIGITS = "inputs", 12
"""Folder of what came through pipes, and digits of the hash by which its files are told apart."""


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
    outputs = _outputs_of_many(targets, output, output_format) if many else [output]
    if not many:
        with suggest_option("--output-format"):
            _check_output(output, output_format)
    _check_printed(output, measure=measure, as_json=as_json)
    if measure and any(target == STREAM or is_pipe(target) for target in targets):
        raise ConfigError("--measure reads the target again, and a pipe can be read only once; use --json")
    _check_not_overwritten(targets, outputs, source)
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
        seed=seed,
        device=device,
        sensor=None if sensor is None else _parse_position("--sensor", sensor),
        noise=None if noise is None else _parse_noise(noise),
        direction=direction,
        guidance={key: value for key, value in guidance.items() if value is not None},
        target_landmarks=target_landmarks,
        symmetric=symmetric,
        offset=offset,
        cleaning=CleaningOptions(weld, repair),
        overrides=overrides or (),
    )
    check_options(options)
    tables = _correspondences(correspondence, [*targets, source], outputs, options, many=many)
    run_options = RunOptions(jobs=jobs, quiet=quiet, as_json=as_json)
    try:
        with _folder(keep) as folder:
            fitting = _Fitting(options, folder, run_options, output_format, keep is not None, started)
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
    return 0 if len(verdicts) == len(targets) else EXIT_FAILED


def _check_landmarks(landmarks: str | None, target_landmarks: str | None, targets: Sequence[str]) -> None:
    if target_landmarks is not None and landmarks is None:
        raise ConfigError("--target-landmarks: gives places of the names in --landmarks; give that too")
    if target_landmarks is not None and len(targets) > 1 and "{target}" not in target_landmarks:
        raise ConfigError("--target-landmarks: of several targets, give each its own, as in 'landmarks/{target}.csv'")


def _parse_position(option: str, text: str) -> tuple[float, float, float]:
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise ConfigError(f"{option} {text}: expected three numbers with commas between them, such as 0,0,2.5")
    return x, y, z


def _parse_noise(text: str) -> Literal["auto"] | float:
    if text == "auto":
        return "auto"
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise ConfigError(f"--noise {text}: expected auto, or a length of 0 or more in the unit of the target's file")
    return value


def _check_targets(targets: Sequence[str]) -> None:
    """Refuse what is no mesh but something else of meshfit, and name the command for it."""
    for target in targets:
        if is_config_name(target):
            command = f"meshfit run {shell_path(target)}"
            raise ConfigError(f"{path_text(target)} is a config, not a mesh; to run it: {command}")
        if is_folder(target) and not is_image_target(target):
            command = f"meshfit fit {shell_path(target.rstrip('/'))}/* -o fitted/"
            raise ConfigError(f"{path_text(target)} is a folder, not a mesh; to fit the meshes in it: {command}")


@dataclass(frozen=True)
class _Job:
    """A target, the trial that fits it, and the files to write."""

    target: str
    output: str
    table: str | None
    trial: "Trial"


@dataclass(frozen=True)
class _Fitting:
    """Plans fits, runs them in a run directory and writes their results."""

    options: FitOptions
    folder: Path
    run_options: RunOptions
    output_format: str | None
    kept: bool
    started: float

    def plan(
        self,
        targets: Sequence[str],
        outputs: Sequence[str],
        tables: Sequence[str | None],
        input_format: str | None,
        *,
        many: bool,
    ) -> list[_Job]:
        """Plan one fit per target; of many, name those that cannot be fitted, and go on."""
        jobs = []
        for target, output, table in zip(targets, outputs, tables, strict=True):
            try:
                with suggest_option("--format"):
                    trial = plan_fit(self._file_of(target, input_format), self.options)
                    jobs.append(_Job(target, output, table, trial))
            except MeshfitError as error:
                if not many:
                    raise
                print_error(str(error) if target in str(error) else f"{path_text(target)}: {error}")
        return jobs

    def _file_of(self, target: str, input_format: str | None) -> str:
        """The file of a target; the content of standard input and of pipes is saved in the folder."""
        from meshfit.experiment.storage.run_directory import make_folder
        from meshfit.mesh.io.mesh_file import write_file
        from meshfit.mesh.targets import NAMED_TARGETS, open_target

        if target in NAMED_TARGETS or is_image_target(target):
            return target
        if target != STREAM and not is_pipe(target) and input_format is None:
            return target
        file = open_target(target, file_format=input_format, points=True)
        stem = "standard-input" if target == STREAM else file_stem(target)
        # Pipes of equal names differ in content.
        path = self.folder / _INPUTS / sha256(file.content).hexdigest()[:_DIGITS] / f"{stem}{file.suffix}"
        make_folder(path.parent)
        write_file(path, file.content)
        return str(path)

    def run(self, jobs: Sequence[_Job], *, many: bool) -> list[tuple["Verdict", dict[str, object]]]:
        """Run the fits; write and judge each as soon as it is complete."""
        from meshfit.cli.experiments import run_trials_of
        from meshfit.cli.fit_progress import show_fit
        from meshfit.cli.progress import show_progress
        from meshfit.experiment.running.backends import ProgressReader
        from meshfit.experiment.storage.run_directory import RunDirectory
        from meshfit.experiment.trial_status import Outcome, TrialStatus

        store = RunDirectory(self.folder)
        trials = list({job.trial.folder: job.trial for job in jobs}.values())
        if not trials:
            return []
        verdicts: dict[int, tuple[Verdict, dict[str, object]]] = {}
        settled: set[int] = set()

        def settle(outcomes: Mapping[int, Outcome]) -> None:
            for i in [i for i in outcomes if i not in settled]:
                settled.add(i)
                same = [k for k, job in enumerate(jobs) if job.trial.folder == trials[i].folder]
                for k in same:
                    if outcomes[i].status is TrialStatus.COMPLETE:
                        try:
                            verdicts[k] = self._write(jobs[k], store, many=many)
                        except MeshfitError as error:
                            print_error(str(error))
                    else:
                        print_error(f"{path_text(jobs[k].target)}: {outcomes[i].message}")

        quiet = self.run_options.quiet
        progress = show_progress(trials, quiet=quiet) if many else show_fit(trials[0], quiet=quiet)
        with progress as watch:

            def watch_and_settle(reader: ProgressReader, outcomes: Mapping[int, Outcome]) -> None:
                watch(reader, outcomes)
                if many:
                    settle(outcomes)

            outcomes = run_trials_of(trials, store, self.run_options, watch_and_settle)
        settle(outcomes)
        return [verdicts[k] for k in sorted(verdicts)]

    def _write(self, job: _Job, store: "RunDirectory", *, many: bool) -> tuple["Verdict", dict[str, object]]:
        """Write the result of a complete trial, and print the verdict on it."""
        from meshfit.cli.verdict import verdict_of
        from meshfit.experiment.storage.attributes import with_attributes
        from meshfit.experiment.storage.frame import frame_of, written_frame
        from meshfit.experiment.storage.run_directory import CORRESPONDENCE
        from meshfit.experiment.storage.targets import read_written_mesh
        from meshfit.measuring.metrics import MEASURED, OF_IMAGES
        from meshfit.mesh.attributes import SUPPORTED
        from meshfit.mesh.io.files import mesh_output_suffix
        from meshfit.mesh.io.mesh_file import write_file

        folder, record = store.folder(job.trial), store.result(job.trial)
        if record is None:
            raise MeshError(f"{path_text(job.target)}: its trial in {folder} has no result")
        path = folder / "result.ply"
        mesh = with_attributes(read_written_mesh(path), path, record)
        if written_frame(record) == "normalised":
            mesh = frame_of(record).restore(mesh)
        chosen = _FORMAT_OF_MANY if many and self.output_format is None else self.output_format
        if mesh_output_suffix(job.output, chosen) != ".ply":
            # The share is in the verdict, and other formats have no place for the marks.
            mesh = mesh.with_attributes(mesh.attributes.without(SUPPORTED))
        _save(mesh, job.output, chosen)
        if job.table is not None:
            write_file(job.table, (folder / CORRESPONDENCE).read_bytes())
        stem = file_stem(job.target)
        for text in record["warnings"]:
            # The verdict says this itself.
            if not text.startswith("source and target differ in topology") and text not in record["shortfalls"]:
                warn_once(text if not many or stem in text.partition(": ")[0] else f"{path_text(job.target)}: {text}")
        name = "standard output" if job.output in STDOUT_PATHS else path_text(job.output)
        waited = None if many else time.monotonic() - self.started
        verdict = verdict_of(job.target, name, folder, record, waited)
        # Lines of stderr go above the bars that are shown there.
        above_bars = many and err.is_terminal and out.is_terminal
        console = err if job.output in STDOUT_PATHS or above_bars else out
        if not self.run_options.as_json:
            for line in [verdict.line] if many else verdict.lines:
                console.print(line, soft_wrap=True, markup=False)
            if self.kept and not many:
                console.print(f"trial: {folder}", soft_wrap=True, markup=False)
        groups = dict.fromkeys(metric.partition(".")[0] for metric in (*MEASURED, *OF_IMAGES))
        return verdict, {group: record[group] for group in groups if group in record}


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


def _check_printed(output: str, *, measure: bool, as_json: bool) -> None:
    if output in STDOUT_PATHS and (measure or as_json):
        raise ConfigError("standard output can have only one of the mesh, --measure and --json; give OUT a name")
    if measure and as_json:
        raise ConfigError("--measure prints a table; --json has all metrics without it")


def _check_output(output: str, output_format: str | None) -> None:
    """Refuse an output that cannot be written, before the fit.

    Raises:
        MeshError: an unknown format, a folder that does not exist, or a place that is read-only.
    """
    from meshfit.mesh.io.files import mesh_output_suffix

    mesh_output_suffix(output, output_format)
    if output in STDOUT_PATHS:
        if sys.stdout is None:
            raise MeshError("standard output: it is closed; give the path of a file")
        return
    _check_place(output)


def _check_place(output: str) -> None:
    """Refuse the path of a file that cannot be written."""
    path = Path(output)
    folder = path.parent
    if not folder.is_dir():
        raise MeshError(f"{path_text(output)}: cannot be written: there is no folder {path_text(folder)}; create it")
    if path.exists() and not path.is_file():
        return  # such as /dev/null
    if not os.access(folder, os.W_OK | os.X_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise MeshError(f"{path_text(output)}: cannot be written: no permission; give another place")
    try:
        with TemporaryFile(dir=os.path.realpath(folder)):
            pass
    except OSError as error:
        raise MeshError(f"{path_text(output)}: cannot be written: {error.strerror}; give another place") from None


def _outputs_of_many(targets: Sequence[str], output: str, output_format: str | None) -> list[str]:
    """Return one file per target in a folder, which is created; equal stems are numbered."""
    from meshfit.experiment.storage.run_directory import make_folder
    from meshfit.mesh.io.files import mesh_output_suffix

    if output in STDOUT_PATHS or (os.path.lexists(output) and not is_folder(output)):
        raise ConfigError(f"-o {path_text(output)}: several targets need a folder; give the path of one")
    if format_suffix(output) in MESH_SUFFIXES and not os.path.lexists(output) and not output.endswith(("/", os.sep)):
        raise ConfigError(
            f"-o {path_text(output)}: several targets need a folder, got a file; {_remedy(targets, output)}"
        )
    suffix = mesh_output_suffix("result", output_format or _FORMAT_OF_MANY)
    folder = Path(output)
    stems = ["standard-input" if target == STREAM else label_of_target(target) for target in targets]
    taken, outputs = set[str](), []
    for stem in stems:
        name, number = stem, 1
        # Some file systems do not tell upper from lower case.
        while name.lower() in taken or (number > 1 and name.lower() in {each.lower() for each in stems}):
            number += 1
            name = f"{stem}-{number}"
        taken.add(name.lower())
        outputs.append(str(folder / f"{name}{suffix}"))
    make_folder(folder)
    for path in outputs:
        _check_output(path, output_format or _FORMAT_OF_MANY)
    return outputs


def _remedy(targets: Sequence[str], output: str) -> str:
    """Return what to give instead of several targets and a file."""
    if len(targets) != 2:  # a template and a scan, maybe
        return "give -o fitted/"
    template, scan = (shell_path(target) for target in targets)
    command = f"meshfit fit {scan} -o {shell_path(output)} --source {template} --connectivity fixed"
    return f"give -o fitted/, or, to bring the first to the second: {command}"


def _correspondences(
    path: Path | None, inputs: Sequence[str], outputs: Sequence[str], options: FitOptions, *, many: bool
) -> list[str | None]:
    """Return the table of the correspondence of each output, if wanted; refuse those that cannot be written."""
    if path is None:
        return [None] * len(outputs)
    option = f"--correspondence {path_text(path)}"
    if options.connectivity != "fixed":
        remedy = "give --register near-rigid, or --connectivity fixed"
        raise ConfigError(f"{option}: a remeshed result has other vertices than the source; {remedy}")
    if not many and (is_folder(str(path)) or format_suffix(path) in MESH_SUFFIXES):
        raise ConfigError(f"{option}: expected a CSV file; give a name such as pairs.csv")
    if many:
        from meshfit.experiment.storage.run_directory import make_folder

        make_folder(path)
    if any(map(is_image_target, inputs)):
        raise ConfigError(f"{option}: images have no faces or points to number; leave it out")
    tables = [str(path / f"{file_stem(output)}.csv") if many else str(path) for output in outputs]
    taken = {os.path.realpath(name) for name in (*inputs, *outputs)}
    for table in tables:
        if os.path.realpath(table) in taken:
            raise ConfigError(f"{option}: would overwrite a mesh; give another name, such as pairs.csv")
        _check_place(table)
    return [*tables]


def _check_not_overwritten(targets: Sequence[str], outputs: Sequence[str], source: str) -> None:
    if targets.count(STREAM) > 1:
        raise ConfigError("standard input can be read only once")
    inputs = {os.path.realpath(name) for name in (*targets, source) if name != STREAM and os.path.isfile(name)}  # noqa: PTH113
    for output in outputs:
        if output not in STDOUT_PATHS and os.path.realpath(output) in inputs:
            raise ConfigError(f"-o {path_text(output)}: would overwrite a mesh that is read; give another name")


def _save(mesh: "Mesh | PolygonMesh", output: str, output_format: str | None) -> None:
    """Write a mesh; if it cannot be written, keep it in a temporary file, and say where.

    Raises:
        MeshError: it cannot be written, with the path of the temporary file.
    """
    from meshfit.mesh.io.files import save_mesh

    try:
        save_mesh(mesh, output, file_format=output_format)
    except BrokenPipeError:
        raise
    except (MeshError, OSError) as error:
        kept = Path(mkdtemp(prefix="meshfit-fit-"), "result.ply")
        save_mesh(mesh, kept)
        raise MeshError(f"{error}; the result is kept in {path_text(kept)}") from error
