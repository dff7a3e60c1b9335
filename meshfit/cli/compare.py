"""`meshfit compare`: run an experiment with some schemes and compare them."""

from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import reading
from meshfit.cli.options import SELECTION, ExperimentName, RunOptions, Seeds, Targets, takes_run_options
from meshfit.errors import ConfigError


@takes_run_options()
def compare(
    schemes: Annotated[
        list[str],
        typer.Argument(
            help="Two or more schemes, such as interp-loop:alpha=0.5, or files that define one.",
            metavar="SCHEME",
            autocompletion=completions.fitted_schemes,
        ),
    ],
    options: RunOptions,
    config: Annotated[
        str,
        typer.Option(
            "--config",
            help="Settings of the fits: a config file or a bundled config.",
            metavar="CONFIG",
            rich_help_panel=SELECTION,
            autocompletion=completions.configs,
        ),
    ] = "table1",
    targets: Targets = None,
    seeds: Seeds = None,
    name: ExperimentName = None,
) -> int:
    """Compare subdivision schemes, paired by seed.

    Missing trials are run first, in a folder of their own; those that are complete in another experiment of the run
    directory are copied from there. The table shows the differences and their confidence intervals.

    Examples:
        meshfit compare loop interp-loop
        meshfit compare loop interp-loop butterfly --targets bunny,cow --seeds 3
        meshfit compare interp-loop:alpha=0.5 interp-loop --config quickstart
        meshfit compare loop my-scheme.yaml
    """
    from meshfit.cli.experiments import run_and_report
    from meshfit.config.loading import load_experiment, renamed, with_axes
    from meshfit.experiment.plan import plan
    from meshfit.experiment.storage.copies import copies_in

    if len(schemes) < 2:
        raise ConfigError(f"expected two or more schemes to compare, got one: {schemes[0]}")
    experiment = load_experiment(config, options.overrides or ())
    changed = with_axes(experiment, targets=targets, schemes=schemes, seeds=seeds)
    changed = renamed(changed, name, compared=True)
    with reading(changed.settings.targets, quiet=options.quiet):
        trials = plan([changed], remote=options.cluster is not None, copy_of=copies_in(options.runs))
    return run_and_report(trials, options)
