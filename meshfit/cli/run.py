"""`meshfit run`: run experiments, and print their tables."""

from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.options import (
    DEFAULT_RUNS,
    AsJson,
    Baseline,
    Cluster,
    DryRun,
    Force,
    Jobs,
    Metrics,
    Quiet,
    Runs,
    Sets,
    Transfer,
    TransferChoice,
)


def run(
    configs: Annotated[
        list[str],
        typer.Argument(
            help="Config files, or names of bundled ones.", metavar="CONFIG...", autocompletion=completions.configs
        ),
    ],
    runs: Runs = DEFAULT_RUNS,
    overrides: Sets = None,
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
    from meshfit.config.load import load_experiment
    from meshfit.experiment.plan import plan

    workers = Workers(jobs, cluster, transfer.value)
    trials = plan([load_experiment(config, overrides or ()) for config in configs], elsewhere=workers.elsewhere)
    display = Display(metrics, baseline, quiet=quiet, as_json=as_json)
    return run_and_report(trials, runs, workers, display, force=force, dry_run=dry_run)
