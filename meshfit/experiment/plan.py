"""The plan: the trials of an experiment, each with an identity derived from its settings and input files."""

import hashlib
import json
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from meshfit.config.experiment import (
    KEYS_WITH_FILES,
    NO_EFFECT_ON_RESULTS,
    ExperimentSettings,
    SourceSettings,
    TargetSettings,
)
from meshfit.config.loading import Experiment
from meshfit.config.path_parts import path_part
from meshfit.config.sweeps import Variant, variants_of
from meshfit.errors import ConfigError, Faults, MeshfitWarning, error_prefix
from meshfit.experiment.guidance import guidance_of, landmarks_path, read_landmarks
from meshfit.experiment.results_version import RESULTS_VERSION
from meshfit.experiment.source import build_source, is_own_mesh, source_files, stand_in
from meshfit.experiment.truth import truth_path, vertex_counts
from meshfit.fitting.external.tools import TOOLS
from meshfit.fitting.registration.guidance import NO_GUIDANCE
from meshfit.fitting.settings import (
    VIEW_TERMS,
    ExternalSettings,
    FirstOrderSettings,
    FitSettings,
    GaussNewtonSettings,
)
from meshfit.images.specs import is_image_target, label_of_target, title_of_target
from meshfit.images.targets import load_images, load_shape
from meshfit.mesh.cleaning_options import CleaningOptions
from meshfit.mesh.places import Numbering
from meshfit.mesh.targets import NAMED_TARGETS, file_sha256, target_path
from meshfit.paths import is_regular_file, path_text, quoted_path
from meshfit.specs import spec_folder
from meshfit.subdivision.registry import NamedScheme
from meshfit.units import count_text

# Increased whenever these alignments give other numbers; other trials keep their identities.
_ALIGNMENT_VERSION, _SEARCHED = 2, ("pca", "icp")
# About the faces of a visual hull, for estimates of time before it has been carved.
_HULL_FACES = 60_000
_OMITTED_IF_NULL = (
    *(("source", key) for key in (*KEYS_WITH_FILES, "wanted_verts", "wrap", "radius_of")),
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
    """

    experiment: str
    settings: ExperimentSettings
    inputs: tuple[tuple[str, str], ...]
    variant: str = ""
    copies: tuple[tuple[str, str], ...] = ()
    lengthened: str = ""

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

    @property
    def folder(self) -> Path:
        """Its folder, relative to the run directory."""
        scheme = spec_folder(self.scheme)
        return Path(self.experiment, self.target_label, scheme, f"seed-{self.seed}-{self.identity[:10]}")


def target_label(target: str) -> str:
    """The short name of a target: that of a named one, the stem of a file, or of images such as `bunny-12-views`."""
    return label_of_target(target)


def distinct_labels(targets: Iterable[str]) -> dict[str, str]:
    """Return longer labels of the files among targets whose short names are equal, such as `1a04-model_normalized`.

    The suffix is added first, then the nearest folders in which the files differ.
    """
    files = [name for name in dict.fromkeys(targets) if not is_image_target(name) and name not in NAMED_TARGETS]
    others = [target_label(name) for name in dict.fromkeys(targets) if name not in files]
    groups: dict[str, list[str]] = {}
    for name in files:
        groups.setdefault(target_label(name), []).append(name)
    lengthened: dict[str, str] = {}
    for label, names in groups.items():
        if len(names) + others.count(label) == 1:
            continue
        labels = {name: Path(name).name for name in names}
        if len(set(labels.values())) < len(names):
            labels = dict.fromkeys(names, label) if len(set(labels.values())) == 1 else labels
            parents = {name: Path(os.path.abspath(name)).parts[-2::-1] for name in names}  # noqa: PTH100
            for depth in range(max(map(len, parents.values()))):
                parts = {name: folders[depth] if depth < len(folders) else "" for name, folders in parents.items()}
                if len({(labels[name], parts[name]) for name in names}) > len(set(labels.values())):
                    labels = {name: f"{parts[name]}-{labels[name]}" for name in names}
        lengthened |= labels
    return lengthened


def plan(experiments: Sequence[Experiment], *, remote: bool = False) -> list[Trial]:
    """List the trials of each experiment: variants × targets × schemes × seeds, in this order.

    Every target and every source is loaded once, so that bad input is refused before the first trial starts.

    Args:
        experiments: the experiments.
        remote: whether they will run on other machines, so that this one need not have their device.

    Raises:
        MeshfitError: a sweep, a target, a source or the device cannot be used; with the faults of all experiments.
    """
    trials: dict[Path, Trial] = {}
    faults = Faults()
    for experiment in experiments:
        with faults.collected(f"{experiment.name}: " if len(experiments) > 1 else ""):
            path_part(experiment.name, "experiment", "rename its config, or give --name")
            variants = variants_of(experiment.settings)
            targets = dict.fromkeys(target for variant in variants for target in variant.settings.targets)
            labels = distinct_labels(targets)
            for target in targets:
                label = labels.get(target) or target_label(target)
                with faults.collected():
                    path_part(label, f"target {quoted_path(target)}: its name", "rename the file")
            equal: dict[str, dict[str, None]] = {}
            for variant in variants:
                if not remote:
                    _check_device(variant.settings)
                firsts = set()
                for trial in _trials_of(experiment.name, variant, labels):
                    firsts.add(trials.setdefault(trial.folder, trial).variant)
                if len(firsts) == 1 and variant.name not in firsts:  # schemes that a point does not affect are no news
                    equal.setdefault(firsts.pop(), {})[variant.name] = None
            for first_name, others in equal.items():
                _warn_of_equal(experiment.name, [first_name, *others])
    faults.raise_any()
    return list(trials.values())


def _warn_of_equal(experiment: str, names: Sequence[str]) -> None:
    listed = ", ".join(f"'{name}'" for name in names)
    text = f"{experiment}: {listed} are the same trials; they run once, as '{names[0]}'"
    warnings.warn(text, MeshfitWarning, stacklevel=3)


def _trials_of(experiment: str, variant: Variant, labels: Mapping[str, str]) -> Iterator[Trial]:
    settings = variant.settings
    schemes = tuple(NamedScheme.of(scheme, settings.define) for scheme in settings.schemes)
    source_inputs, targets = _check_inputs(settings, schemes)
    for target in settings.targets:
        inputs = (("target", targets[target]), *source_inputs, *_command_inputs(settings.fit))
        for scheme, seed in product(schemes, _seeds_with_effect(settings)):
            narrowed = {"targets": (target,), "schemes": (scheme.spec,), "seeds": (seed,), "define": dict(scheme.own)}
            truth = truth_path(settings, target_label(target), scheme.spec)
            known = () if truth is None else (("truth", file_sha256(Path(truth))),)
            places = landmarks_path(settings, target_label(target))
            of_target = () if places is None else (("target-landmarks", file_sha256(Path(places))),)
            yield Trial(
                experiment,
                settings.model_copy(update=narrowed),
                (*inputs, *known, *of_target),
                variant.name,
                lengthened=labels.get(target, ""),
            )


def _check_inputs(
    settings: ExperimentSettings, schemes: tuple[NamedScheme, ...]
) -> tuple[tuple[tuple[str, str], ...], dict[str, str]]:
    """Return the SHA-256 of the source's files, by role, and of each target's.

    Raises:
        MeshfitError: with a line for the source and each target that cannot be used.
    """
    source: tuple[tuple[str, str], ...] = ()
    targets: dict[str, str] = {}
    faults = Faults()
    with faults.collected():
        source = _check_source(settings.source, schemes)
    for target in settings.targets:
        with faults.collected():
            checked = checked_target(target, settings.cleaning)
            _check_kind(target, checked, settings)
            targets[target] = checked.sha256
    faults.raise_any()
    for target in settings.targets:
        with faults.collected():
            places = landmarks_path(settings, target_label(target))
            _check_guidance(settings.source, schemes, places, target, settings.cleaning)
            _check_symmetry(settings.source, schemes, settings.fit)
    faults.raise_any()
    if settings.target.truth is not None:
        _check_vertices_stay(settings)
        for target, scheme in product(settings.targets, schemes):
            with faults.collected():
                _check_truth(settings, target_label(target), scheme)
        faults.raise_any()
    return source, targets


def _check_vertices_stay(settings: ExperimentSettings) -> None:
    """Refuse a truth for results whose vertices are not those of one source.

    Raises:
        ConfigError: naming the setting.
    """
    if settings.source.is_made_from_target:
        made = f"made from the target ({settings.source.mesh})"
        raise ConfigError(
            f"target.truth: the vertices of a source that is {made} belong nowhere; set source.mesh to a file, or "
            "remove it"
        )
    if getattr(settings.fit, "connectivity", "fixed") != "fixed":
        raise ConfigError(
            "target.truth: a remeshed result has other vertices than the source; set fit.connectivity: fixed, or "
            "remove it"
        )


def _check_truth(settings: ExperimentSettings, target: str, scheme: NamedScheme) -> None:
    """Read the file of the truth.

    Raises:
        MeshfitError: it cannot be read, or has another number of vertices.
    """
    path = truth_path(settings, target, scheme.spec)
    assert path is not None  # noqa: S101  the settings have one
    vertex_counts(settings.source, scheme, settings.fit).truth(path, path)


@cache
def _check_guidance(
    source: SourceSettings,
    schemes: tuple[NamedScheme, ...],
    target_landmarks: str | None,
    target: str,
    cleaning: CleaningOptions,
) -> None:
    """Read the landmarks and the values of vertices.

    Raises:
        MeshfitError: they cannot be read, or do not go with the source or the target.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)  # a trial gives them
        landmarks = read_landmarks(source, target_landmarks)
        if landmarks is not None and landmarks.goals_are_numbered:
            landmarks.goal_positions(load_shape(target, cleaning), Numbering.of_file(target))
        guidance_of(source.model_copy(update={"levels": 0, "wanted_verts": None}), schemes[0].resolve())


@cache
def _check_symmetry(source: SourceSettings, schemes: tuple[NamedScheme, ...], fit: FitSettings) -> None:
    """Check that a source, or its first level, is symmetric where the fit is to keep it so.

    Raises:
        MeshfitError: it is not, or it is not registered.
    """
    if not (isinstance(fit, GaussNewtonSettings) and fit.symmetric):
        return
    if fit.register == "auto" and not is_own_mesh(source):
        raise ConfigError(
            f"fit.symmetric: source.mesh: {source.mesh} is made to start from, and is not registered; set source.mesh "
            "to a file, or remove it"
        )
    short = source.model_copy(update={"levels": min(source.levels, 1), "wanted_verts": None})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)  # a trial gives them
        for scheme in schemes:
            masks = scheme.resolve()
            known = guidance_of(short, masks) or NO_GUIDANCE
            with error_prefix("fit"):
                known.mirrored(build_source(stand_in(short), masks, scheme.spec))


class CheckedTarget(NamedTuple):
    """A target that can be loaded.

    Attributes:
        sha256: of its file, or of all that images are made from.
        faces: their number; of images, about that of their shape.
        points: their number, where there are no faces.
        fault: why no closed surface can be fitted to the points, in words; empty if one can.
        views: number of images; 0 for a mesh or points.
        maps: what all images have besides masks, of `depth` and `normals`.
    """

    sha256: str
    faces: int
    points: int
    fault: str
    views: int = 0
    maps: tuple[str, ...] = ()


@cache
def checked_target(target: str, cleaning: CleaningOptions) -> CheckedTarget:
    """Load a target, once in this process, and return what a plan needs to know of it."""
    from meshfit.mesh.point_cloud import PointCloud, no_closed_surface

    if is_image_target(target):
        images = load_images(target)
        shape = images.target.shape if images.target.views.have_depth else None
        points = 0 if shape is None else shape.num_verts
        fault = no_closed_surface(shape) if isinstance(shape, PointCloud) else ""
        faces = 0 if points else _HULL_FACES
        views = images.target.views
        return CheckedTarget(images.sha256, faces, points, fault, len(views), views.maps)
    loaded = load_shape(target, cleaning)
    points = 0 if loaded.num_faces else loaded.num_verts
    fault = no_closed_surface(loaded) if isinstance(loaded, PointCloud) else ""
    return CheckedTarget(file_sha256(target_path(target)), loaded.num_faces, points, fault)


def _check_images(name: str, checked: CheckedTarget, settings: ExperimentSettings) -> None:
    """Refuse settings that images make needless, and those that only images have."""
    if settings.source.mesh == "hull" and not checked.views:
        raise ConfigError(f"{name}: not given by images, whose masks have a visual hull; use source.mesh: auto")
    if checked.views and settings.target.surface == "outer":
        raise ConfigError(f"{name}: images show the outside alone; remove target.surface: outer")
    if settings.target.sensor is not None and (checked.views or not checked.points):
        known = "its cameras are known" if checked.views else "its faces tell the outside"
        raise ConfigError(f"{name}: {known}, so target.sensor has no effect; remove it")


def _check_kind(target: str, checked: CheckedTarget, settings: ExperimentSettings) -> None:
    """Refuse settings that do not go with a target of points, or with one of faces.

    Raises:
        ConfigError: naming the setting.
    """
    fit, name = settings.fit, path_text(target)
    _check_images(name, checked, settings)
    if isinstance(fit, FirstOrderSettings) and (fault := fit.fault_with(checked.maps if checked.views else None)):
        raise ConfigError(f"{name}: fit.{fault}")
    if not checked.points or (checked.views and isinstance(fit, FirstOrderSettings)):
        return
    cloud = f"{name}: a cloud of {count_text(checked.points, 'point')}, without the faces that"
    if isinstance(fit, FirstOrderSettings):
        raise ConfigError(f"{cloud} fit.method: first-order samples; use fit.method: gauss-newton")
    if isinstance(fit, ExternalSettings) and not fit.takes_points:
        able = [tool for tool, entry in TOOLS.items() if entry.points]
        remedy = f"fit.tool: {', '.join(able)}" if fit.tool is not None else "fit.format: ply or obj"
        raise ConfigError(f"{cloud} {fit.name} needs; use {remedy}, or fit.method: gauss-newton")
    if settings.target.surface == "outer":
        raise ConfigError(f"{cloud} target.surface: outer selects from; remove it")
    if settings.source.mesh == "target":
        raise ConfigError(f"{cloud} source.mesh: target starts from; use source.mesh: wrap or auto")
    if checked.fault and not source_files(settings.source):
        raise ConfigError(f"{name}: {checked.fault}")


@cache
def _check_source(settings: SourceSettings, schemes: tuple[NamedScheme, ...]) -> tuple[tuple[str, str], ...]:
    """Build the first level of a source with each scheme, and return the SHA-256 of its files, by role.

    A control mesh that will be made from a target is not made yet, as this takes seconds for each.
    """
    files = source_files(settings)
    for scheme in schemes:
        short = settings.model_copy(update={"levels": min(settings.levels, 1), "wanted_verts": None})
        build_source(stand_in(short), scheme.resolve(), scheme.spec)
    return tuple((role, file_sha256(target_path(name))) for role, name in files.items())


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
