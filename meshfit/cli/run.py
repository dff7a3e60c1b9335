"""`meshfit run`: run experiments, and print their tables."""

from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.options import (
    DEFAULT_RUNS,
    SELECTION,
    AsJson,
    Baseline,
    Cluster,
    DryRun,
    Force,
    Jobs,
    Metrics,
    Overrides,
    Quiet,
    Runs,
    Transfer,
    TransferChoice,
)
from meshfit.errors import ConfigError


def run(
    configs: Annotated[
        list[str],
        typer.Argument(
            help="Config files, or names of bundled ones.", metavar="CONFIG...", autocompletion=completions.configs
        ),
    ],
    runs: Runs = DEFAULT_RUNS,
    overrides: Overrides = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    transfer: Transfer = TransferChoice.AUTO,
    metrics: Metrics = None,
    baseline: Baseline = None,
    force: Force = False,
    dry_run: DryRun = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> int:
    """Run experiments and print their table.

    Every target is fitted with every scheme and every seed. Complete trials are kept, an interrupted one goes on from
    its last checkpoint.

    Bundled configs: quickstart (under 2 minutes), table1, reproduce, tutorial, schemes, accurate, accurate-fixed.

    Examples:
        meshfit run quickstart

        meshfit run my.yaml --set fit.steps=500 --set fit.losses.edge=0.5

        meshfit run table1 --dry-run  # what would run, and about how long it takes
    """
    from meshfit.cli.experiments import Display, Workers, run_and_report
    from meshfit.config.loading import load_experiment
    from meshfit.experiment.plan import plan

    workers = Workers(jobs, cluster, transfer.value)
    trials = plan([load_experiment(config, overrides or ()) for config in configs], elsewhere=workers.elsewhere)
    display = Display(metrics, baseline, quiet=quiet, as_json=as_json)
    return run_and_report(trials, runs, workers, display, force=force, dry_run=dry_run)


def compare(
    schemes: Annotated[
        list[str],
        typer.Argument(
            help="Two schemes or more, as in interp-loop:alpha=0.5; or files that define one.",
            metavar="SCHEMES...",
            autocompletion=completions.fitted_schemes,
        ),
    ],
    config: Annotated[
        str,
        typer.Option(
            "--config",
            help="Settings of the fits: a config file or a bundled one.",
            metavar="CONFIG",
            rich_help_panel=SELECTION,
            autocompletion=completions.configs,
        ),
    ] = "table1",
    targets: Annotated[
        str | None,
        typer.Option(
            "--targets",
            help="Targets, comma-separated, in place of the config's.",
            metavar="A,B",
            rich_help_panel=SELECTION,
            autocompletion=completions.listed_targets,
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            "--seeds", min=1, help="Seeds 0 to N-1, in place of the config's.", metavar="N", rich_help_panel=SELECTION
        ),
    ] = None,
    runs: Runs = DEFAULT_RUNS,
    overrides: Overrides = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    transfer: Transfer = TransferChoice.AUTO,
    metrics: Metrics = None,
    baseline: Baseline = None,
    force: Force = False,
    dry_run: DryRun = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> int:
    """Compare subdivision schemes, paired by seed.

    What is missing is run; then comes a table with the differences and their intervals.

    Examples:
        meshfit compare loop interp-loop

        meshfit compare loop interp-loop butterfly --targets bunny,cow --seeds 3

        meshfit compare interp-loop:alpha=0.5 interp-loop --config quickstart

        meshfit compare loop my-scheme.yaml
    """
    from meshfit.cli.experiments import Display, Workers, run_and_report
    from meshfit.config.loading import Experiment, load_experiment
    from meshfit.config.scheme_files import resolve_specs
    from meshfit.experiment.plan import plan
    from meshfit.settings import override

    if len(schemes) < 2:
        raise ConfigError(f"found one scheme, {schemes[0]}; two or more are needed to compare")
    experiment = load_experiment(config, overrides or ())
    specs, own = resolve_specs(schemes, experiment.settings.define)
    define = {name: definition.model_dump(mode="json") for name, definition in own.items()}
    changes: dict[str, object] = {"schemes": specs, "define": define}
    if targets is not None:
        changes["targets"] = [target.strip() for target in targets.split(",") if target.strip()]
    if seeds is not None:
        changes["seeds"] = list(range(seeds))
    workers = Workers(jobs, cluster, transfer.value)
    changed = Experiment(experiment.name, override(experiment.settings, changes))
    trials = plan([changed], elsewhere=workers.elsewhere)
    display = Display(metrics, baseline, quiet=quiet, as_json=as_json)
    return run_and_report(trials, runs, workers, display, force=force, dry_run=dry_run)
