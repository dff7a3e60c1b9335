"""The trial that `meshfit fit` runs: the bundled config `accurate`, with the settings that options change."""

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from meshfit.errors import ConfigError, error_prefix
from meshfit.paths import is_regular_file, looks_like_path

if TYPE_CHECKING:
    from meshfit.config.loading import Experiment
    from meshfit.experiment.plan import Trial
    from meshfit.mesh.cleaning_options import CleaningOptions, Keep

_NAME, _ANY_TARGET = "fit", "bunny"
_FIXED_VERTS = 10242
BUILT = ("auto", "target", "closed", "open", "wrap", "hull", "sphere")
"""Sources that are made, not read from a file."""


@dataclass(frozen=True)
class FitOptions:
    """The options that change a fit; None leaves a setting as `accurate` has it."""

    verts: int | None
    scheme: str
    levels: int | None
    connectivity: Literal["remeshed", "fixed"]
    source: str
    register: Literal["auto", "rigid", "near-rigid", "soft", "off"] | None
    surface: Literal["all", "outer"]
    keep_pieces: "Keep"
    seed: int
    device: str | None
    sensor: tuple[float, float, float] | None
    noise: Literal["auto"] | float | None
    direction: Literal["both", "to-target", "to-source"] | None
    guidance: Mapping[str, str]
    target_landmarks: str | None
    symmetric: bool
    offset: float | None
    cleaning: "CleaningOptions"
    overrides: Sequence[str]

    @property
    def registers(self) -> bool:
        """Whether the source is registered: by default, a file that keeps its faces."""
        if self.register is None:
            return self.connectivity == "fixed" and self.source not in BUILT
        return self.register != "off"


def parse_position(option: str, text: str) -> tuple[float, float, float]:
    """Return the position of an option, `X,Y,Z`.

    Raises:
        ConfigError: not three finite numbers.
    """
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise ConfigError(f"{option} {text}: expected three numbers with commas between them, such as 0,0,2.5")
    return x, y, z


def parse_noise(text: str) -> Literal["auto"] | float:
    """Return the value of `--noise`.

    Raises:
        ConfigError: neither auto nor a length of 0 or more.
    """
    if text == "auto":
        return "auto"
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise ConfigError(f"--noise {text}: expected auto, or a length of 0 or more in the unit of the target's file")
    return value


def parse_keep(text: str) -> "Keep":
    """Return the value of `--keep-pieces`.

    Raises:
        ConfigError: neither all, largest nor a share.
    """
    from meshfit.mesh.cleaning_options import as_keep

    try:
        return as_keep(text if text in ("all", "largest") else float(text))
    except ValueError:
        message = f"--keep-pieces {text}: expected all, largest, or a share above 0 and up to 1"
    raise ConfigError(message)


def check_options(options: FitOptions) -> None:
    """Refuse settings that fit no target.

    Raises:
        MeshfitError: a setting or the scheme cannot be used.
    """
    from meshfit.config.loading import load_experiment
    from meshfit.config.scheme_files import resolve_specs
    from meshfit.subdivision.registry import registry_with, resolve

    if not any(setting.startswith("define") for setting in options.overrides):
        with error_prefix("--scheme"):
            (spec,), own = resolve_specs([options.scheme], {})
            resolve(spec, registry_with(own))
    load_experiment("accurate", [*_plain(_ANY_TARGET, options), *options.overrides])


def plan_fit(target: str, options: FitOptions) -> "Trial":
    """Return the trial that fits one target.

    Raises:
        MeshfitError: a setting, the target, the source or the device cannot be used.
    """
    from meshfit.config.loading import load_experiment
    from meshfit.experiment.plan import plan

    plain = list(_plain(target, options))
    experiment = load_experiment("accurate", [*plain, *options.overrides])
    given = {"fit.noise": None if options.noise == "auto" else options.noise, "fit.offset": options.offset}
    lengths = {key: length for key, length in given.items() if length is not None}
    if lengths:
        scale = _scale(target, options, experiment)
        plain += [_setting(key, length / scale) for key, length in lengths.items()]
        experiment = load_experiment("accurate", [*plain, *options.overrides])
    if options.source not in BUILT:
        placed = list(_placed(target, options, experiment))
        experiment = load_experiment("accurate", [*plain, *placed, *options.overrides])
    trials = plan([replace(experiment, name=_NAME)])
    if len(trials) != 1:
        raise ConfigError(f"--set: expected the settings of one fit, got {len(trials)} fits; use `meshfit run`")
    return trials[0]


def _setting(key: str, value: object) -> str:
    return f"{key}={json.dumps(value)}"


def _plain(target: str, options: FitOptions) -> Iterator[str]:
    yield _setting("targets", [_absolute(target)])
    yield _setting("schemes", [options.scheme])
    yield _setting("seeds", [options.seed])
    if options.surface != "all":
        yield _setting("target.surface", options.surface)
    yield _setting("fit.connectivity", options.connectivity)
    yield from _of_template(options)
    if options.cleaning.weld:
        yield _setting("weld", options.cleaning.weld)
    yield _setting("repair", options.cleaning.repair)
    if options.device is not None:
        yield _setting("device", options.device)
    yield from _of_scan(options)
    own_faces = options.connectivity == "fixed" and options.source not in BUILT
    levels = 0 if own_faces and options.levels is None else options.levels
    if levels is not None:
        yield _setting("fit.levels", levels)
    if options.connectivity == "remeshed":
        if options.verts is not None:
            yield _setting("fit.verts", options.verts)
    elif own_faces and options.verts is not None:
        raise ConfigError("--verts: a fit with --connectivity fixed keeps the vertices of --source; use --levels")
    if options.source in BUILT:
        yield _setting("source.mesh", options.source)
        if options.connectivity == "fixed":
            yield _setting("source.wanted_verts", _control_verts(options))


def _of_template(options: FitOptions) -> Iterator[str]:
    for key in (*options.guidance, *(["symmetric"] if options.symmetric else [])):
        if options.source in BUILT:
            raise ConfigError(f"--{key}: requires --source FILE, the mesh that it is about")
        if options.register == "off":
            raise ConfigError(f"--{key}: only a registration uses it; leave out --register off")
    if not options.registers:
        return
    if options.source in BUILT:
        raise ConfigError("--register: requires --source FILE, a mesh each of whose vertices has a meaning")
    yield _setting("fit.register", options.register or "auto")
    if options.symmetric:
        yield _setting("fit.symmetric", True)


def _of_scan(options: FitOptions) -> Iterator[str]:
    """Settings of scans; a noise that is a length follows once the frame is known."""
    if options.keep_pieces is not None:
        yield _setting("target.keep", options.keep_pieces)
    if options.sensor is not None:
        yield _setting("target.sensor", list(options.sensor))
    if options.noise == "auto":
        yield _setting("fit.noise", options.noise)
    if options.direction is not None:
        yield _setting("fit.direction", options.direction)


def _control_verts(options: FitOptions) -> int:
    """Vertices of the source, which each level makes into 4 V - 6 on a sphere."""
    levels = 1 if options.levels is None else options.levels
    return max(12, int(((options.verts or _FIXED_VERTS) - 2) / 4**levels) + 2)


def _scale(target: str, options: FitOptions, experiment: "Experiment") -> float:
    """The length of the target's file that is 1 in the normalised frame."""
    from meshfit.images.targets import load_shape
    from meshfit.mesh.normalisation import frame_of
    from meshfit.mesh.separate_pieces import kept_pieces

    shape = kept_pieces(load_shape(target, options.cleaning), experiment.settings.target.keep)
    return frame_of(shape.verts, experiment.settings.normalise).scale


def _placed(target: str, options: FitOptions, experiment: "Experiment") -> Iterator[str]:
    """Settings of a control mesh from a file, which keeps its place relative to the target."""
    from meshfit.images.targets import load_shape
    from meshfit.mesh.any_target import require_mesh
    from meshfit.mesh.mismatch import describe_mismatch
    from meshfit.mesh.separate_pieces import kept_pieces
    from meshfit.mesh.targets import load_target

    target_mesh = kept_pieces(load_shape(target, options.cleaning), experiment.settings.target.keep)
    with error_prefix("--source"):
        control = require_mesh(load_target(options.source), options.source)
    yield _setting("source.mesh", _absolute(options.source))
    yield _setting("source.levels", 0)
    yield _setting("source.project", "none")
    yield _setting("source.frame", "target")
    yield from _guidance(options)
    if not options.registers and describe_mismatch(control, target_mesh):
        yield _setting("source.align", "pca")


def _guidance(options: FitOptions) -> Iterator[str]:
    """Settings of landmarks and of values of vertices: files, or names of vertex data."""
    for key, text in options.guidance.items():
        if key == "landmarks":
            yield _setting("source.landmarks.file", os.path.abspath(text))  # noqa: PTH100  keeps links
        elif is_regular_file(text) or looks_like_path(text):
            yield _setting(f"source.{key}.file", os.path.abspath(text))  # noqa: PTH100  keeps links
        else:
            yield _setting(f"source.{key}.attribute", text)
    if options.target_landmarks is not None:
        yield _setting("target.landmarks", os.path.abspath(options.target_landmarks))  # noqa: PTH100  keeps links


def _absolute(name: str) -> str:
    from meshfit.mesh.targets import NAMED_TARGETS

    return name if name in NAMED_TARGETS or not os.path.lexists(name) else os.path.abspath(name)  # noqa: PTH100  keeps links
