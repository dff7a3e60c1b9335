"""`meshfit run`: run experiments and print their table."""

from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.fit_command import fit_command, is_mesh_name
from meshfit.cli.options import ExperimentName, RunOptions, Schemes, Seeds, Targets, takes_run_options
from meshfit.errors import ConfigError
from meshfit.paths import path_text


@takes_run_options
def run(
    configs: Annotated[
        list[str],
        typer.Argument(
            help="Config files, or names of bundled configs.", metavar="CONFIG", autocompletion=completions.configs
        ),
    ],
    options: RunOptions,
    targets: Targets = None,
    schemes: Schemes = None,
    seeds: Seeds = None,
    name: ExperimentName = None,
) -> int:
    """Run experiments and print their table.

    Every target is fitted with every scheme and every seed. Completed trials are kept; an interrupted trial resumes
    from its last checkpoint. With other targets or schemes than those of the config, the experiment gets a folder of
    its own; trials that are complete in another experiment of the run directory are copied from there.

    Bundled configs: quickstart (under 2 minutes), table1, reproduce, tutorial, schemes, accurate, accurate-fixed.

    Examples:
        meshfit run quickstart
        meshfit run my.yaml --set fit.steps=500 --set fit.losses.edge=0.5
        meshfit run my.yaml --targets scan.obj,bunny --seeds 3
        meshfit run table1 --dry-run  # the plan, and about how long it takes
    """
    from meshfit.cli.experiments import run_and_report
    from meshfit.config.loading import load_experiment, renamed, with_axes
    from meshfit.experiment.plan import plan
    from meshfit.specs import listed

    if meshes := [config for config in configs if is_mesh_name(config)]:
        raise ConfigError(f"{path_text(meshes[0])} is a mesh, not a config; to fit it: {fit_command(meshes)}")
    listed_schemes = None if schemes is None else listed(schemes)
    loaded = (load_experiment(config, options.overrides or ()) for config in configs)
    experiments = [with_axes(each, targets=targets, schemes=listed_schemes, seeds=seeds) for each in loaded]
    if name is not None and len(configs) > 1:
        raise ConfigError(f"--name: expected one config, got {len(configs)}; run them one by one")
    experiments = [renamed(experiment, name) for experiment in experiments]
    return run_and_report(plan(experiments, remote=options.cluster is not None), options)
