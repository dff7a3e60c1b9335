"""The plan: from an experiment's settings to its trials, each with an identity of its own."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from meshfit.config.experiment import ExperimentSettings, SourceSettings
from meshfit.config.load import Experiment
from meshfit.experiment.source import build_source, source_file
from meshfit.mesh.targets import NAMED_TARGETS, file_sha256, load_target, target_path

# Raised whenever the same settings would give other numbers, so that older results are not taken for newer ones.
SCHEMA_VERSION = 2


@dataclass(frozen=True)
class Trial:
    """One cell of an experiment.

    Attributes:
        experiment: the name it is filed under.
        settings: the experiment's settings, narrowed to one target, one scheme and one seed.
        inputs: SHA-256 of every file that is read, by role.
    """

    experiment: str
    settings: ExperimentSettings
    inputs: tuple[tuple[str, str], ...]

    @property
    def target(self) -> str:
        """The target, as the config names it."""
        return self.settings.targets[0]

    @property
    def scheme(self) -> str:
        """The scheme's spec."""
        return self.settings.schemes[0]

    @property
    def seed(self) -> int:
        """The seed."""
        return self.settings.seeds[0]

    @property
    def plain_settings(self) -> dict[str, Any]:
        """The settings as plain data, without those that no result depends on."""
        return self.settings.model_dump(mode="json", exclude={"jobs", "threads"})

    @cached_property
    def identity(self) -> str:
        """SHA-256 over the settings, the inputs and the schema version; where a mesh file lies does not enter."""
        settings = _without_paths(self.plain_settings)
        content = {"settings": settings, "inputs": dict(self.inputs), "schema_version": SCHEMA_VERSION}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    @property
    def label(self) -> str:
        """Target, scheme and seed, for a person to read."""
        return f"{target_label(self.target)} · {self.scheme} · seed {self.seed}"

    @property
    def folder(self) -> Path:
        """Where it is kept, relative to the run directory."""
        scheme = self.scheme.replace(":", "-").replace("=", "-").replace(",", "-")
        return Path(self.experiment, target_label(self.target), scheme, f"seed-{self.seed}-{self.identity[:10]}")


def target_label(target: str) -> str:
    """A short name: that of a named target, or the stem of a file."""
    return target if target in NAMED_TARGETS else Path(target).stem


def plan(experiments: Sequence[Experiment]) -> list[Trial]:
    """The trials of some experiments: targets × schemes × seeds of each, in this order.

    Every target and every source is loaded once here, so that bad input is refused before the first trial starts.

    Raises:
        MeshfitError: a target, a source or the device cannot be used.
    """
    trials: dict[Path, Trial] = {}
    for experiment in experiments:
        settings = experiment.settings
        _check_device(settings)
        source_input = _check_source(settings.source, settings.schemes)
        for target in settings.targets:
            inputs = (("target", _check_target(target)), *source_input)
            for scheme in settings.schemes:
                for seed in settings.seeds:
                    one = {"targets": (target,), "schemes": (scheme,), "seeds": (seed,)}
                    trial = Trial(experiment.name, settings.model_copy(update=one), inputs)
                    trials.setdefault(trial.folder, trial)
    return list(trials.values())


@cache
def _check_target(target: str) -> str:
    load_target(target)
    return file_sha256(target_path(target))


def _check_source(settings: SourceSettings, schemes: Sequence[str]) -> tuple[tuple[str, str], ...]:
    file = source_file(settings)
    for scheme in schemes:
        build_source(settings.model_copy(update={"levels": min(settings.levels, 1)}), scheme)
    return () if file is None else (("source", file_sha256(file)),)


def _check_device(settings: ExperimentSettings) -> None:
    if settings.device not in ("auto", "cpu"):
        from meshfit.fitting.device import resolve_device  # torch takes a second, which other plans need not wait

        resolve_device(settings.device, settings.dtype)


def _without_paths(settings: dict[str, Any]) -> dict[str, Any]:
    source = settings["source"] | {"mesh": target_label(settings["source"]["mesh"])}
    return settings | {"targets": [target_label(name) for name in settings["targets"]], "source": source}
