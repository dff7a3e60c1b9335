"""The plan: the trials of an experiment, each with an identity derived from its settings and input files."""

import hashlib
import json
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from meshfit.config.experiment import NO_EFFECT_ON_RESULTS, ExperimentSettings
from meshfit.config.loading import Experiment
from meshfit.config.path_parts import OWN_IN_EXPERIMENT, OWN_IN_RUNS, path_part, require_distinct
from meshfit.config.source_settings import KEYS_WITH_FILES
from meshfit.config.sweeps import Variant, variants_of
from meshfit.config.target_settings import TargetSettings
from meshfit.errors import ConfigError, Faults, MeshfitWarning
from meshfit.experiment.guidance import landmarks_path
from meshfit.experiment.input_checks import CopyFinder, Errors, TargetCopy, check_inputs
from meshfit.experiment.results_version import RESULTS_VERSION
from meshfit.experiment.target_labels import distinct_labels, target_label
from meshfit.experiment.truth import truth_path
from meshfit.fitting.settings import (
    VIEW_TERMS,
    ExternalSettings,
    FitSettings,
)
from meshfit.images.specs import is_image_target, title_of_target
from meshfit.mesh.targets import NAMED_TARGETS, file_sha256
from meshfit.paths import is_regular_file, quoted_path
from meshfit.specs import spec_folder
from meshfit.subdivision.registry import NamedScheme

# Increased whenever these alignments give other numbers; other trials keep their identities.
_ALIGNMENT_VERSION, _SEARCHED = 3, ("pca", "icp")
_RENAME_EXPERIMENT = "rename its config, or give --name"
_OMITTED_IF_NULL = (
    *(("source", key) for key in (*KEYS_WITH_FILES, "wanted_verts", "wrap", "radius_of", "frame")),
    ("target", "keep"),
    ("fit", "views"),
    *(("fit", "losses", term) for term in VIEW_TERMS),
)


@dataclass(frozen=True)
class Trial:
    """One fit of an experiment: one target, one scheme, one seed.

    Attributes:
        experiment: name of the experiment.
        settings: settings of the experiment, narrowed to one target, one scheme and one seed.
        inputs: SHA-256 of every file that is read, by role.
        variant: name of its point in a sweep; empty where nothing is swept. Not part of the identity.
        copies: current paths of files that are not where the settings say, by the name in the settings. Not part of
            the identity.
        lengthened: label of its target, where another target of the experiment has the same short name. Not part of
            the identity.
        fault: why its target cannot be used, in one line; empty if it can. Such a trial has no target among its inputs,
            and fails without being started.
    """

    experiment: str
    settings: ExperimentSettings
    inputs: tuple[tuple[str, str], ...]
    variant: str = ""
    copies: tuple[tuple[str, str], ...] = ()
    lengthened: str = ""
    fault: str = ""

    @property
    def target(self) -> str:
        """The target, as the config names it."""
        return self.settings.targets[0]

    @property
    def scheme(self) -> str:
        """The spec of the scheme."""
        return self.settings.schemes[0]

    @property
    def named_scheme(self) -> NamedScheme:
        """The spec of the scheme, with the definitions that it depends on."""
        return NamedScheme.of(self.scheme, self.settings.define)

    @property
    def seed(self) -> int:
        """The seed."""
        return self.settings.seeds[0]

    @property
    def files(self) -> dict[str, str]:
        """The meshes and tables of the user that it reads, by role; files of a command stay where they are."""
        source = self.settings.source
        names = {"target": self.target, "source": source.mesh}
        for role in KEYS_WITH_FILES:
            options = getattr(source, role)
            if options is not None and options.file is not None:
                names[role] = options.file
        if self.target_landmarks is not None:
            names["target-landmarks"] = self.target_landmarks
        if self.truth is not None:
            names["truth"] = self.truth
        return {role: names[role] for role, _ in self.inputs if role in names and names[role] not in NAMED_TARGETS}

    @property
    def truth(self) -> str | None:
        """The file with the places where the vertices of the source belong, as the config names it."""
        return truth_path(self.settings, target_label(self.target), self.scheme)

    @property
    def target_landmarks(self) -> str | None:
        """The file of the places on the target, as the config names it."""
        return landmarks_path(self.settings, target_label(self.target))

    def current_path(self, name: str) -> str:
        """The current path of a file that the settings name."""
        return dict(self.copies).get(name, name)

    @property
    def plain_settings(self) -> dict[str, Any]:
        """The settings as plain data, without those that have no effect on results.

        Definitions, creases, alphas, `wanted_verts`, `wrap`, `radius_of` and `target` are left out where they are not
        set, so that trials of older versions, which did not have them, keep their identities.
        """
        default = {"target"} if self.settings.target == TargetSettings() else set()
        excluded = NO_EFFECT_ON_RESULTS | dict.fromkeys(default, True)
        plain = _without_unset(self.settings.model_dump(mode="json", exclude=excluded))
        return plain if plain["define"] else {key: value for key, value in plain.items() if key != "define"}

    @property
    def config(self) -> dict[str, Any]:
        """The settings as the config in its folder has them: the plain ones, and the limits of an external tool."""
        plain, fit = self.plain_settings, self.settings.fit
        if not isinstance(fit, ExternalSettings):
            return plain
        return plain | {"fit": plain["fit"] | {"time_limit": fit.time_limit, "memory_limit": fit.memory_limit}}

    @cached_property
    def identity(self) -> str:
        """SHA-256 over settings, inputs and `RESULTS_VERSION`; independent of the names and paths of files."""
        settings = _without_paths(self.plain_settings)
        if self.settings.source.wanted_verts is not None and not self.settings.source.is_made_from_target:
            settings["source"] = {key: value for key, value in settings["source"].items() if key != "levels"}
        content = {"settings": settings, "inputs": dict(self.inputs), "schema_version": RESULTS_VERSION}
        if self.settings.source.align in _SEARCHED:
            content["alignment"] = _ALIGNMENT_VERSION
        if self.fault:  # in place of the content of the target, which may be missing
            content["target"] = self.target_label
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    @property
    def target_label(self) -> str:
        """The short name of the target, which no other target of the experiment has."""
        return self.lengthened or target_label(self.target)

    @property
    def names(self) -> dict[str, Any]:
        """The names by which records identify it: target, title of the target, scheme, seed and variant."""
        target = {"target": self.target_label, "target_title": self.lengthened or title_of_target(self.target)}
        return target | {"scheme": self.scheme, "seed": self.seed, "variant": self.variant}

    @property
    def label(self) -> str:
        """Target, scheme, variant and seed, to be read by a person."""
        parts = [self.target_label, self.scheme, self.variant, f"seed {self.seed}"]
        return " · ".join(part for part in parts if part)

    @cached_property
    def folder(self) -> Path:
        """Its folder, relative to the run directory."""
        scheme = spec_folder(self.scheme)
        return Path(self.experiment, self.target_label, scheme, f"seed-{self.seed}-{self.identity[:10]}")


def plan(experiments: Sequence[Experiment], *, remote: bool = False, copy_of: CopyFinder | None = None) -> list[Trial]:
    """List the trials of each experiment: variants × targets × schemes × seeds, in this order.

    Every target and every source is loaded once. The trials of a target that cannot be used have a `fault`; other bad
    input is refused before the first trial starts, and so is an experiment none of whose targets can be used.

    Args:
        experiments: the experiments.
        remote: whether they will run on other machines, so that this one need not have their device.
        copy_of: finds the copy of a target whose file is missing, such as `copies_in(runs)`; None for no copies.

    Raises:
        MeshfitError: a sweep, a source, the device or all targets cannot be used, or a target is neither a file nor the
            name of one; with the faults of all experiments.
    """
    trials: dict[Path, Trial] = {}
    faults = Faults()
    errors_in_loading: Errors = {}
    with faults.collected():
        names = {experiment.name: experiment.name for experiment in experiments}
        require_distinct(names, "experiments", _RENAME_EXPERIMENT)
    for experiment in experiments:
        with faults.collected(f"{experiment.name}: " if len(experiments) > 1 else ""):
            path_part(experiment.name, "experiment", _RENAME_EXPERIMENT, own=OWN_IN_RUNS)
            variants = variants_of(experiment.settings)
            targets = dict.fromkeys(target for variant in variants for target in variant.settings.targets)
            labels = distinct_labels(targets)
            folders = {target: labels.get(target) or target_label(target) for target in targets}
            for target, label in folders.items():
                with faults.collected():
                    what = f"target {quoted_path(target)}: its name"
                    path_part(label, what, "rename the file", own=OWN_IN_EXPERIMENT)
            schemes = dict.fromkeys(scheme for variant in variants for scheme in variant.settings.schemes)
            for scheme in schemes:
                with faults.collected():
                    path_part(spec_folder(scheme), f"scheme {quoted_path(scheme)}: its folder", "rename the scheme")
            with faults.collected():
                require_distinct(folders, "targets", "rename one, or give each an experiment of its own")
                require_distinct({scheme: spec_folder(scheme) for scheme in schemes}, "schemes", "rename one")
            equal: dict[str, dict[str, None]] = {}
            for variant in variants:
                if not remote:
                    _check_device(variant.settings)
                firsts = set()
                copies = _copies(copy_of, experiment.name, variant.settings, labels)
                for trial in _trials_of(experiment.name, variant, labels, errors_in_loading, copies):
                    firsts.add(trials.setdefault(trial.folder, trial).variant)
                if len(firsts) == 1 and variant.name not in firsts:  # schemes that a point does not affect are no news
                    equal.setdefault(firsts.pop(), {})[variant.name] = None
            for first_name, others in equal.items():
                _warn_of_equal(experiment.name, [first_name, *others])
    faults.raise_any()
    return list(trials.values())


def require_usable(trials: Iterable[Trial]) -> None:
    """Refuse trials whose targets cannot be used.

    Raises:
        ConfigError: with a line for each target.
    """
    if faults := dict.fromkeys(trial.fault for trial in trials if trial.fault):
        raise ConfigError(*faults)


def _warn_of_equal(experiment: str, names: Sequence[str]) -> None:
    listed = ", ".join(f"'{name}'" for name in names)
    text = f"{experiment}: {listed} are the same trials; they run once, as '{names[0]}'"
    warnings.warn(text, MeshfitWarning, stacklevel=3)


def _copies(
    copy_of: CopyFinder | None, experiment: str, settings: ExperimentSettings, labels: Mapping[str, str]
) -> dict[str, TargetCopy]:
    """Return the copies of the targets whose files are missing."""
    if copy_of is None:
        return {}
    found = {
        target: copy_of(experiment, target, labels.get(target) or target_label(target), settings.cleaning)
        for target in settings.targets
    }
    return {target: copy for target, copy in found.items() if copy is not None}


def _trials_of(
    experiment: str,
    variant: Variant,
    labels: Mapping[str, str],
    errors_in_loading: Errors,
    copies: Mapping[str, TargetCopy],
) -> Iterator[Trial]:
    settings = variant.settings
    schemes = tuple(NamedScheme.of(scheme, settings.define) for scheme in settings.schemes)
    checked = check_inputs(settings, schemes, errors_in_loading, copies)
    for target in settings.targets:
        fault = checked.faults.get(target, "")
        inputs = (*checked.source, *_command_inputs(settings.fit))
        if not fault:
            inputs = (("target", checked.targets[target]), *inputs)
        copy = checked.copies.get(target)
        name = target if copy is None else copy.name
        for scheme, seed in product(schemes, _seeds_with_effect(settings)):
            narrowed = {"targets": (name,), "schemes": (scheme.spec,), "seeds": (seed,), "define": dict(scheme.own)}
            known = () if fault else _known_inputs(settings, target, scheme)
            yield Trial(
                experiment,
                settings.model_copy(update=narrowed),
                (*inputs, *known),
                variant.name,
                () if copy is None else ((name, str(copy.path)),),
                lengthened=labels.get(target, ""),
                fault=fault,
            )


def _known_inputs(settings: ExperimentSettings, target: str, scheme: NamedScheme) -> tuple[tuple[str, str], ...]:
    """Return the SHA-256 of the files with what is known of a target, by role."""
    truth = truth_path(settings, target_label(target), scheme.spec)
    places = landmarks_path(settings, target_label(target))
    files = {"truth": truth, "target-landmarks": places}
    return tuple((role, file_sha256(Path(path))) for role, path in files.items() if path is not None)


def command_files(fit: FitSettings) -> dict[str, str]:
    """Return the files among the arguments of an external command, such as a script, by role."""
    if not isinstance(fit, ExternalSettings) or fit.command is None:
        return {}
    paths = {f"command-{number}": part for number, part in enumerate(fit.command)}
    return {role: part for role, part in paths.items() if Path(part).is_absolute() and is_regular_file(Path(part))}


def _command_inputs(fit: FitSettings) -> tuple[tuple[str, str], ...]:
    return tuple((role, file_sha256(Path(path))) for role, path in command_files(fit).items())


def _seeds_with_effect(settings: ExperimentSettings) -> tuple[int, ...]:
    """Return the seeds; only the first for a tool whose result does not depend on it."""
    fit = settings.fit
    deterministic = isinstance(fit, ExternalSettings) and not fit.depends_on_seed
    return settings.seeds[:1] if deterministic else settings.seeds


def _check_device(settings: ExperimentSettings) -> None:
    if settings.device not in ("auto", "cpu"):
        from meshfit.fitting.device import resolve_device  # loads torch, which other plans do without

        resolve_device(settings.device, settings.dtype)


def _without_unset(settings: dict[str, Any]) -> dict[str, Any]:
    """Remove the settings of `_OMITTED_IF_NULL` that are null, where they are."""
    for *groups, key in _OMITTED_IF_NULL:
        group = settings
        for name in groups:
            group = group.get(name, {})
        if key in group and group[key] is None:
            del group[key]
    return settings


def _without_paths(settings: dict[str, Any]) -> dict[str, Any]:
    source = dict(settings["source"])
    if source["mesh"] not in NAMED_TARGETS and Path(source["mesh"]).suffix:  # a file, whose content is an input
        source["mesh"] = "file"
    for key in KEYS_WITH_FILES:
        if source.get(key) and source[key]["file"]:
            source[key] = source[key] | {"file": "file"}
    if settings["fit"].get("command"):
        names = [Path(part).name if Path(part).is_absolute() else part for part in settings["fit"]["command"]]
        settings = settings | {"fit": settings["fit"] | {"command": names}}
    if settings.get("target", {}).get("truth"):
        settings = settings | {"target": settings["target"] | {"truth": "file"}}
    if settings.get("target", {}).get("landmarks"):
        settings = settings | {"target": settings["target"] | {"landmarks": "file"}}
    targets = [target_label(name) for name in settings["targets"] if is_image_target(name)]
    return settings | {"targets": targets, "source": source}
