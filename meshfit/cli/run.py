"""`meshfit run`: run experiments and print their table."""

from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.options import RunOptions, takes_run_options


@takes_run_options
def run(
    configs: Annotated[
        list[str],
        typer.Argument(
            help="Config files, or names of bundled configs.", metavar="CONFIG", autocompletion=completions.configs
        ),
    ],
    options: RunOptions,
) -> int:
    """Run experiments and print their table.

    Every target is fitted with every scheme and every seed. Completed trials are kept; an interrupted trial resumes
    from its last checkpoint.

    Bundled configs: quickstart (under 2 minutes), table1, reproduce, tutorial, schemes, accurate, accurate-fixed.

    Examples:
        meshfit run quickstart
        meshfit run my.yaml --set fit.steps=500 --set fit.losses.edge=0.5
        meshfit run table1 --dry-run  # the plan, and about how long it takes
    """
    from meshfit.cli.experiments import run_and_report
    from meshfit.config.loading import load_experiment
    from meshfit.experiment.plan import plan

    experiments = [load_experiment(config, options.overrides or ()) for config in configs]
    return run_and_report(plan(experiments, remote=options.cluster is not None), options)
