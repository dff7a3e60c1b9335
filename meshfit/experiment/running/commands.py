"""Permission to run the external commands of a config, and the check that tools are installed."""

import os
import shlex
import shutil
from collections.abc import Iterable

from meshfit.errors import ClusterError, ConfigError
from meshfit.experiment.plan import Trial
from meshfit.fitting.external.tools import INSTALL, missing_module
from meshfit.fitting.settings import ExternalSettings

WORKER_VARIABLE = "MESHFIT_ALLOW_COMMANDS"
"""Environment variable with which a remote worker is started, set to 1, so that it runs commands that it is sent."""
_MOST_LISTED = 3


def has_command(trial: Trial) -> bool:
    """Return whether a trial runs a command from its config, rather than code of this package."""
    fit = trial.settings.fit
    return isinstance(fit, ExternalSettings) and fit.command is not None


def require_permission(trials: Iterable[Trial], *, allowed: bool) -> None:
    """Refuse trials with commands, unless they are allowed.

    Raises:
        ConfigError: showing the commands.
    """
    commands = dict.fromkeys(
        shlex.join(command)
        for trial in trials
        if isinstance(trial.settings.fit, ExternalSettings) and not allowed
        for command in (trial.settings.fit.version_command, trial.settings.fit.command)
        if command is not None
    )
    if commands:
        shown = "; ".join([*list(commands)[:_MOST_LISTED], *["…"] * (len(commands) > _MOST_LISTED)])
        text = f"fit.command: the config runs a program on this machine: {shown}; if you trust it"
        raise ConfigError(f"{text}, give --allow-commands")


def require_installed(trials: Iterable[Trial]) -> None:
    """Refuse trials whose tools are not installed on this machine.

    Raises:
        ConfigError: with a line for each tool.
    """
    fits = {trial.settings.fit.model_dump_json(): trial.settings.fit for trial in trials}
    external = (fit for fit in fits.values() if isinstance(fit, ExternalSettings))
    faults = dict.fromkeys(fault for fit in external if (fault := missing_tool(fit)) is not None)
    if faults:
        raise ConfigError(*faults)


def missing_tool(settings: ExternalSettings) -> str | None:
    """Return why this machine cannot run a tool, in one line; None if nothing is missing."""
    if settings.tool is not None:
        module = missing_module(settings.tool)
        return None if module is None else f"fit.tool: {settings.tool} needs {module}: {INSTALL}"
    for key in ("command", "version_command"):
        command = getattr(settings, key)
        if command and "{" not in command[0] and shutil.which(command[0]) is None:
            return f"fit.{key}: {command[0]}: no such program on this machine"
    return None


def require_worker_permission() -> None:
    """Refuse to run commands in this remote worker, unless it was started to do so.

    Raises:
        ClusterError: it was not.
    """
    if not worker_allows_commands():
        raise ClusterError(
            f"a worker runs no commands of configs; to allow them, start workers with {WORKER_VARIABLE}=1 set"
        )


def worker_allows_commands() -> bool:
    """Return whether this remote worker was started to run commands."""
    return os.environ.get(WORKER_VARIABLE) == "1"
