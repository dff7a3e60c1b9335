"""`meshfit run`: run experiments and print their table."""

from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import reading
from meshfit.cli.fit_command import fit_command, is_mesh_name
from meshfit.cli.options import ExperimentName, RunOptions, Schemes, Seeds, Targets, takes_run_options
from meshfit.errors import ConfigError, Faults
from meshfit.paths import path_text


@takes_run_options()
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

    Bundled configs: quickstart (under 2 minutes), table1, reproduce, tutorial, schemes, accurate, accurate-sphere,
    accurate-fixed, metamorphosis, and peers, which compares with other tools.

    Examples:
        meshfit run quickstart
        meshfit run my.yaml --set fit.steps=500 --set fit.losses.edge=0.5
        meshfit run my.yaml --targets scan.obj,bunny --seeds 3
        meshfit run table1 --dry-run  # the plan, and about how long it takes
    """
    from meshfit.cli.experiments import run_and_report
    from meshfit.config.loading import Experiment, load_experiment, renamed, with_axes
    from meshfit.experiment.plan import plan
    from meshfit.experiment.storage.copies import copies_in
    from meshfit.specs import listed

    if meshes := [config for config in configs if is_mesh_name(config)]:
        raise ConfigError(f"{path_text(meshes[0])} is a mesh, not a config; to fit it: {fit_command(meshes)}")
    listed_schemes = None if schemes is None else listed(schemes)
    if name is not None and len(configs) > 1:
        raise ConfigError(f"--name: expected one config, got {len(configs)}; run them one by one")
    faults, experiments = Faults(), list[Experiment]()
    for config in configs:
        with faults.collected():
            loaded = load_experiment(config, options.overrides or ())
            experiments.append(renamed(with_axes(loaded, targets=targets, schemes=listed_schemes, seeds=seeds), name))
    targets_to_read = [target for experiment in experiments for target in experiment.settings.targets]
    with faults.collected(), reading(targets_to_read, quiet=options.quiet):
        trials = plan(experiments, remote=options.cluster is not None, copy_of=copies_in(options.runs))
    faults.raise_any()
    return run_and_report(trials, options)
