"""`meshfit tune`: search for the settings that are best by a metric."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from meshfit.cli import completions
from meshfit.cli.console import EXIT_FAILED, err, out
from meshfit.cli.fit_command import fit_command, is_mesh_name
from meshfit.cli.options import (
    OUTPUT,
    SELECTION,
    ExperimentName,
    RunOptions,
    Schemes,
    Seeds,
    Targets,
    split_metrics,
    takes_run_options,
)
from meshfit.cli.progress import Lines, TrialBars, bars_with_states
from meshfit.errors import ConfigError
from meshfit.paths import path_text, shell_path
from meshfit.units import count_text, duration_text

if TYPE_CHECKING:
    from meshfit.config.experiment import ExperimentSettings
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.running.scheduler import Watcher
    from meshfit.experiment.storage.run_directory import RunDirectory
    from meshfit.experiment.tuning.search import Problem
    from meshfit.experiment.tuning.search_file import Search

_FIRST_LINE = "# Found by `meshfit tune`"


def _direction(option: str, text: str) -> Any:  # noqa: ANN401  an option of Typer
    return typer.Option(
        option,
        help=text,
        metavar="NAME,...",
        rich_help_panel=SELECTION,
        autocompletion=completions.listed_metrics,
        callback=split_metrics,
    )


@takes_run_options("metrics", "baseline")
def tune(
    config: Annotated[
        str,
        typer.Argument(
            help="Config file with ranges under sweep.ranges, or name of a bundled config.",
            metavar="CONFIG",
            autocompletion=completions.configs,
        ),
    ],
    options: RunOptions,
    metrics: Annotated[
        list[str] | None,
        _direction("--metric", "Metric to improve, in the direction in which it is better. May be repeated."),
    ] = None,
    maximise: Annotated[
        list[str] | None, _direction("--maximise", "Metric to be as large as possible. May be repeated.")
    ] = None,
    minimise: Annotated[
        list[str] | None, _direction("--minimise", "Metric to be as small as possible. May be repeated.")
    ] = None,
    trials: Annotated[
        int,
        typer.Option(
            "--trials",
            min=1,
            help="Settings to try in all, those of earlier runs included; each with every target, scheme and seed.",
            metavar="N",
            rich_help_panel=SELECTION,
        ),
    ] = 100,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Config to write with the best settings; with several metrics, one variant per point of the front.",
            metavar="FILE",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    targets: Targets = None,
    schemes: Schemes = None,
    seeds: Seeds = None,
    name: ExperimentName = None,
) -> int:
    """Search for the settings that are best by a metric.

    The config gives ranges under sweep.ranges, as for a sampled sweep. The first 16 settings fill these ranges evenly;
    then Optuna's TPE sampler chooses batches of 8. Each is fitted with every target, scheme and seed, and compared by
    the mean over the seeds and the geometric mean over targets and schemes. With several metrics, the Pareto front is
    shown. The same command resumes a search; more --trials continue it. Requires the extra: pip install
    'meshfit[tune]'.

    Examples:
        meshfit tune my.yaml --metric hausdorff.symmetric --trials 100
        meshfit tune my.yaml --metric distance.mean --trials 200 --output best.yaml
        meshfit tune my.yaml --metric distance.mean,f_score.f1 --schemes loop --targets bunny,cow
        meshfit tune my.yaml --metric distance.mean --dry-run
    """
    from meshfit.config.loading import load_experiment, renamed, with_axes
    from meshfit.config.sweep_samples import RANGES, SAMPLE, SampleSettings, read_ranges, sample_settings
    from meshfit.experiment.running.scheduler import require_runnable
    from meshfit.experiment.storage.copies import copies_in
    from meshfit.experiment.storage.run_directory import RunDirectory
    from meshfit.experiment.tuning.objectives import objectives_of
    from meshfit.experiment.tuning.search import Problem, start_search
    from meshfit.measuring.metrics import DEFAULT_METRIC
    from meshfit.specs import listed

    if is_mesh_name(config):
        raise ConfigError(f"{path_text(config)} is a mesh, not a config; to fit it: {fit_command([config])}")
    asked = metrics or ([] if maximise or minimise else [DEFAULT_METRIC])
    objectives = objectives_of(asked, maximise or (), minimise or ())
    if output is not None:
        _check_output(output, config)
    loaded = load_experiment(config, options.overrides or (), _check_ranges)
    named = with_axes(loaded, targets=targets, schemes=None if schemes is None else listed(schemes), seeds=seeds)
    experiment = renamed(named, name or f"{renamed(named, None).name}-tune")
    sweep = loaded.settings.sweep
    sample = sample_settings(sweep[SAMPLE]) if SAMPLE in sweep else SampleSettings(points=1)
    ranges, copy_of = read_ranges(sweep[RANGES]), copies_in(options.runs)
    problem = Problem(experiment, ranges, objectives, sample, options.cluster is not None, copy_of)
    search = start_search(problem, options.runs, new=options.force)
    store = RunDirectory(options.runs)
    if options.dry_run:
        return _print_plan(problem, search, trials, store, options)
    for point in (search.own, *search.points):
        if point.state != "failed":
            require_runnable(problem.trials(point), allow_commands=options.allow_commands, here=options.cluster is None)
            break
    search = _run(problem, search, trials, store, options)
    if not search.complete:
        return _print_none(search)
    if options.as_json:
        typer.echo(_json(search))
    else:
        print_best(search, trials)
        out.print(f"\nResults: {options.runs / experiment.name}", soft_wrap=True, markup=False)
    if output is not None:
        _write_best(search, experiment.settings, output)
        if not options.as_json:
            out.print(f"wrote {output}; now: meshfit run {shell_path(output)}", soft_wrap=True, markup=False)
    return 0


def _check_output(path: Path, config: str) -> None:
    """Refuse a config to write that cannot be written, or that would replace one by hand.

    Raises:
        ConfigError: another suffix, no folder, or a file that no search wrote.
    """
    from meshfit.paths import CONFIG_SUFFIXES

    if path.suffix.lower() not in CONFIG_SUFFIXES:
        raise ConfigError(f"--output {path_text(path)}: expected a file that ends in {' or '.join(CONFIG_SUFFIXES)}")
    if not path.parent.is_dir():
        raise ConfigError(f"--output {path_text(path)}: there is no folder {path_text(path.parent)}")
    if path.is_dir():
        raise ConfigError(f"--output {path_text(path)}: is a folder; give the path of a file")
    if path.exists():
        is_config = Path(config).exists() and path.samefile(config)
        with path.open(encoding="utf-8", errors="replace") as file:
            is_written = file.readline().startswith(_FIRST_LINE)
        if is_config or not is_written:
            what = "is the config that is searched" if is_config else "exists, and no search wrote it"
            raise ConfigError(f"--output {path_text(path)}: {what}; give another path, or move it away")


def _check_ranges(settings: "ExperimentSettings", where: Callable[[], str]) -> None:
    """Refuse a sweep that cannot be searched.

    Raises:
        ConfigError: it has no ranges, or malformed ones, or other axes.
    """
    from meshfit.config.sweep_samples import RANGES, SAMPLE, read_ranges, sample_settings
    from meshfit.config.sweeps import variants_of

    sweep = settings.sweep
    if RANGES not in sweep:
        example = "sweep: {ranges: {fit.losses.edge: {log: [0.01, 2]}, source.levels: [3, 4, 5]}}"
        raise ConfigError(f"{where()}no ranges to search; give settings and their ranges, such as {example}")
    if others := [key for key in sweep if key not in (SAMPLE, RANGES)]:
        remedy = f"move it to sweep.{RANGES} as a list of values, or remove it"
        raise ConfigError(f"{where()}sweep: {others[0]}: a search varies nothing but its ranges; {remedy}")
    try:
        read_ranges(sweep[RANGES])
        if SAMPLE in sweep:
            sample_settings(sweep[SAMPLE])
    except ConfigError as error:
        raise ConfigError(f"{where()}{error}") from None
    # A key that does not exist is refused here, with its line; values that do not go together fail one by one.
    points = [{"sample": {"points": 2**power}, RANGES: sweep[RANGES]} for power in range(4)]
    errors = []
    for point in points:
        try:
            variants_of(settings.model_copy(update={"sweep": point}), where)
        except ConfigError as error:
            errors.append(error)
    if len(errors) == len(points):
        raise errors[0]


def _print_plan(problem: "Problem", search: "Search", total: int, store: "RunDirectory", options: RunOptions) -> int:
    """Print the number of fits, and about how long they take."""
    from meshfit.cli.experiments import estimated

    pending = [search.own, *(point for point in search.points if point.state == "asked")]
    trials = [trial for point in pending if point.state == "asked" for trial in problem.trials(point)]
    tried = len(search.complete) + len(search.failed)
    per_point = 1
    for cells in search.cells.values():
        per_point *= len(cells)
    fits = max(total - tried, 0) * per_point
    axes = " × ".join(count_text(len(cells), noun[:-1]) for noun, cells in search.cells.items())
    time = (
        None
        if options.cluster is not None or not trials or not fits
        else estimated(trials, trials, store, options.jobs)
    )
    known = None if time is None else time.seconds
    seconds = None if time is None or known is None else known / (len(trials) - time.unknown) * fits
    if options.as_json:
        import json

        typer.echo(json.dumps({"points": total, "tried": tried, "fits": fits, "seconds": seconds}, indent=2))
        return 0
    for key, values in search.ranges.items():
        out.print(f"{key}: {json_text(values)}", soft_wrap=True, markup=False)
    out.print(f"{count_text(total, 'point')} × {axes}: {tried} points tried, {fits} fits to run", markup=False)
    if time is not None and seconds is not None:
        out.print(f"about {duration_text(seconds)} on {count_text(time.workers, 'worker')}, from {time.basis}")
    return 0


def json_text(value: object) -> str:
    """Return a value as JSON on one line."""
    import json

    return json.dumps(value, ensure_ascii=False)


def _run(problem: "Problem", search: "Search", total: int, store: "RunDirectory", options: RunOptions) -> "Search":
    from meshfit.cli.experiments import run_trials_of
    from meshfit.experiment.running.backends import LocalWorkers
    from meshfit.experiment.storage.copying import copy_complete
    from meshfit.experiment.storage.run_directory import make_folder
    from meshfit.experiment.trial_status import Outcome
    from meshfit.experiment.tuning.search import run_search

    make_folder(options.runs)
    with _progress(search, total, quiet=options.quiet) as view, closing(LocalWorkers()) as workers:

        def run(trials: "Sequence[Trial]") -> Mapping[int, Outcome]:
            if not options.force:
                copy_complete(trials, store)
            with view.batch(trials) as watch:
                return run_trials_of(trials, store, options, watch, workers)

        return run_search(problem, search, total, store, run, view.update, new=options.force)


@dataclass
class _View:
    """Progress of a search: points tried, the best so far, and the remaining time."""

    total: int
    tried: int
    bars: Any = None
    lines: Lines | None = None
    started: float = field(default_factory=time.monotonic)
    task: Any = None
    first: int = 0

    def __post_init__(self) -> None:
        self.first = self.tried
        if self.bars is not None:
            self.task = self.bars.add_task("[bold]search", total=self.total, completed=self.tried, state="")

    @contextmanager
    def batch(self, trials: "Sequence[Trial]") -> "Iterator[Watcher]":
        """Show the trials of a batch below the search."""
        if self.bars is not None:
            before = set(self.bars.task_ids)
            bars = TrialBars(trials, self.bars)
            try:
                yield bars.update
            finally:
                for task in set(self.bars.task_ids) - before:
                    self.bars.remove_task(task)
        else:
            yield self._log

    def _log(self, *_: object) -> None:
        if self.lines is not None and self.lines.seconds_of_silence >= 60:
            self.lines.print(f"[{self.tried}/{self.total}] running", even_if_fast=True)

    def update(self, search: "Search") -> None:
        """Show how far the search has come."""
        from meshfit.report.tables.search import value_texts

        self.tried = min(len(search.complete) + len(search.failed), self.total)
        failed = f", {len(search.failed)} failed" if search.failed else ""
        best = "none complete"
        if search.complete:
            best = f"best {', '.join(value_texts(search, search.points[search.best[0]]))}"
        if self.bars is not None:
            self.bars.update(self.task, completed=self.tried, state=f"{self.tried}/{self.total} {best}{failed}")
        if self.lines is not None:
            done, left = self.tried - self.first, self.total - self.tried
            seconds = (time.monotonic() - self.started) * left / done if done else 0.0
            ending = f"; about {duration_text(seconds)} left" if left and done else ""
            self.lines.print(f"[{self.tried}/{self.total}] {best}{failed}{ending}", even_if_fast=True)


@contextmanager
def _progress(search: "Search", total: int, *, quiet: bool) -> Iterator[_View]:
    tried = min(len(search.complete) + len(search.failed), total)
    if quiet:
        yield _View(total, tried)
    elif err.is_terminal and not err.is_dumb_terminal:
        with bars_with_states(speed_estimate_period=3600) as bars:
            yield _View(total, tried, bars=bars)
    else:
        yield _View(total, tried, lines=Lines())


def print_best(search: "Search", total: int | None = None) -> None:
    """Print the best settings of a search, with remarks on them."""
    from rich.table import Table
    from rich.text import Text

    from meshfit.report.tables.search import search_heads, search_notes, search_rows, search_title

    out.print(search_title(search), soft_wrap=True, markup=False)
    grid = Table(box=None, pad_edge=False)
    for place, head in enumerate(search_heads(search)):
        is_setting = len(search.objectives) <= place < len(search.objectives) + len(search.ranges)
        grid.add_column(Text(head), justify="right", no_wrap=not is_setting)
    for row in search_rows(search):
        grid.add_row(*map(Text, row))
    out.print(grid)
    for line in search_notes(search, total):
        out.print(line, soft_wrap=True, markup=False)


def _print_none(search: "Search") -> int:
    reasons = dict.fromkeys(search.points[i].reason for i in search.failed)
    err.print(f"[bold red]all {len(search.failed)} points failed[/]")
    for reason in list(reasons)[:5]:
        err.print(reason, soft_wrap=True, markup=False)
    return EXIT_FAILED


def _json(search: "Search") -> str:
    import json
    from dataclasses import asdict

    points = [asdict(point) | {"number": i + 1} for i, point in enumerate(search.points) if point.state != "asked"]
    rest = {key: value for key, value in asdict(search).items() if key not in ("points", "own")}
    best = [i + 1 for i in search.best]
    return json.dumps({**rest, "own": asdict(search.own), "best": best, "points": points}, indent=2)


def _write_best(search: "Search", settings: "ExperimentSettings", path: Path) -> None:
    """Write the config with the best settings, or with the points of the Pareto front as variants."""
    from meshfit.config.strict_yaml import dump
    from meshfit.config.sweeps import variant_at
    from meshfit.experiment.storage.run_directory import write_atomically
    from meshfit.report.tables.search import value_texts

    best = [search.points[i] for i in search.best]
    names = ", ".join(objective.metric for objective in search.objectives)
    head = f"{_FIRST_LINE} among {count_text(len(search.complete), 'point')}, by {names}:\n"
    head += "".join(f"#   {', '.join(value_texts(search, point))}: {point.name}\n" for point in best)
    if len(search.objectives) == 1:
        sweep, found = {}, variant_at(settings, best[0].changes).settings
    else:
        sweep, found = {"sweep": {"variants": {point.name: dict(point.changes) for point in best}}}, settings
    # As written, since defaults may depend on other settings.
    plain = found.model_dump(mode="json", exclude_unset=True)
    text = dump({key: value for key, value in plain.items() if key != "sweep"} | sweep)
    write_atomically(path, head + text)
