"""Shell completion of names and paths, without heavy imports because it has to be quick."""

import os
from collections.abc import Collection
from pathlib import Path

from meshfit.paths import CONFIG_SUFFIXES, MESH_SUFFIXES, WRITABLE_SUFFIXES, format_suffix

_TRIAL = "seed-"
_TARGETS = "targets"

Completions = list[tuple[str, str]]
"""Values, each with a description."""


def configs(incomplete: str) -> Completions:
    """Bundled configs and YAML files."""
    from meshfit.config.loading import bundled_configs

    return _named(dict.fromkeys(bundled_configs(), "bundled"), incomplete) + _files(incomplete, CONFIG_SUFFIXES)


def schemes(incomplete: str) -> Completions:
    """Subdivision schemes, and YAML files that may define one."""
    from meshfit.subdivision.registry import SCHEMES

    named = _named({name: f"{entry.title}, {entry.kind}" for name, entry in SCHEMES.items()}, incomplete)
    return named + _files(incomplete, CONFIG_SUFFIXES)


def fitted_schemes(incomplete: str) -> Completions:
    """Subdivision schemes on surfaces, which experiments can use."""
    from meshfit.subdivision.registry import SCHEMES

    curves = {name for name, entry in SCHEMES.items() if entry.domain == "curves"}
    return [pair for pair in schemes(incomplete) if pair[0] not in curves]


def listed_schemes(incomplete: str) -> Completions:
    """The last scheme of a comma-separated list."""
    before, comma, last = incomplete.rpartition(",")
    return [(before + comma + value, help_text) for value, help_text in fitted_schemes(last)]


def targets(incomplete: str) -> Completions:
    """Named targets and mesh files."""
    from meshfit.mesh.targets import NAMED_TARGETS

    return _named({name: target.title for name, target in NAMED_TARGETS.items()}, incomplete) + meshes(incomplete)


def listed_targets(incomplete: str) -> Completions:
    """The last target of a comma-separated list."""
    before, comma, last = incomplete.rpartition(",")
    return [(before + comma + value, help_text) for value, help_text in targets(last)]


def meshes(incomplete: str) -> Completions:
    """Mesh files, compressed or not."""
    return _files(incomplete, MESH_SUFFIXES)


def formats(incomplete: str) -> Completions:
    """Mesh formats that are read."""
    return _named({suffix[1:]: "" for suffix in MESH_SUFFIXES}, incomplete)


def output_formats(incomplete: str) -> Completions:
    """Mesh formats that are written."""
    return _named({suffix[1:]: "" for suffix in WRITABLE_SUFFIXES}, incomplete)


def metrics(incomplete: str) -> Completions:
    """Metrics by their dotted names."""
    from meshfit.measuring.metrics import METRICS

    return _named({name: metric.title for name, metric in METRICS.items()}, incomplete)


def listed_metrics(incomplete: str) -> Completions:
    """The last metric of a comma-separated list."""
    before, comma, last = incomplete.rpartition(",")
    return [(before + comma + value, help_text) for value, help_text in metrics(last)]


def listed_measured(incomplete: str) -> Completions:
    """The last metric of a comma-separated list, of those that `meshfit measure` measures."""
    from meshfit.measuring.metrics import OF_MEASUREMENTS

    return [pair for pair in listed_metrics(incomplete) if pair[0].rpartition(",")[2] in OF_MEASUREMENTS]


def limits(incomplete: str) -> Completions:
    """Metrics of a measurement, up to the equals sign."""
    from meshfit.measuring.metrics import OF_MEASUREMENTS

    return _named({f"{name}=": metric.title for name, metric in OF_MEASUREMENTS.items()}, incomplete)


def settings(incomplete: str) -> Completions:
    """Keys of settings, up to the equals sign."""
    from meshfit.config.experiment import ExperimentSettings
    from meshfit.fitting.settings import METHODS, default_fit
    from meshfit.report.tables.grouping import flatten

    plain = ExperimentSettings().model_dump(mode="json")
    fits = [plain["fit"] | default_fit(method) for method in reversed(METHODS)]
    defaults = {key: value for fit in fits for key, value in flatten(plain | {"fit": fit}).items()}
    return _named({f"{key}=": f"default {value}" for key, value in defaults.items()}, incomplete)


def folders(incomplete: str) -> Completions:
    """Folders, such as run directories and folders in them."""
    return [(str(folder), "") for folder in _folders(incomplete)]


def trials(incomplete: str) -> Completions:
    """Folders of trials, or the folders above them where there is a choice."""
    candidates = _folders(incomplete)
    while len(candidates) == 1 and not candidates[0].name.startswith(_TRIAL):
        below = _folders(f"{candidates[0]}{os.sep}")
        if not below:
            break
        candidates = below
    return [(str(folder), "") for folder in candidates]


def meshes_or_trials(incomplete: str) -> Completions:
    """Targets, mesh files and folders of trials: everything that can be drawn."""
    return [*targets(incomplete), *(pair for pair in trials(incomplete) if _TRIAL in pair[0])]


def _named(names: dict[str, str], incomplete: str) -> Completions:
    return [(name, meaning) for name, meaning in names.items() if name.startswith(incomplete)]


def _files(incomplete: str, suffixes: Collection[str]) -> Completions:
    """Files with these suffixes, and folders that may contain more."""
    folders = {path: path.is_dir() for path in _paths(incomplete)}
    chosen = {path: is_folder for path, is_folder in folders.items() if is_folder or format_suffix(path) in suffixes}
    return [(f"{path}{os.sep}" if is_folder else str(path), "") for path, is_folder in chosen.items()]


def _folders(incomplete: str) -> list[Path]:
    """Folders that start with the text, without the one of carried targets."""
    paths = [path for path in _paths(incomplete) if path.is_dir()]
    return [path for path in paths if path.name != _TARGETS or any(below.is_dir() for below in path.glob("*"))]


def _paths(incomplete: str) -> list[Path]:
    """Paths that start with the text; hidden ones only if its last part starts with a dot."""
    folder, name = os.path.split(incomplete)
    try:
        paths = sorted(Path(os.path.expanduser(folder) or ".").iterdir())  # noqa: PTH111  leaves an unknown ~user as it is
    except OSError:
        return []
    return [path for path in paths if path.name.startswith(name) and path.name.startswith(".") == name.startswith(".")]
