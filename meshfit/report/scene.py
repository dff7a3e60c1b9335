"""From what a person names to what is drawn: mesh files, targets and trials, each in its frame and with its view."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from meshfit.errors import ConfigError
from meshfit.mesh.frames import frame_of
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.targets import NAMED_TARGETS, load_target, target_title
from meshfit.report.pictures import Shown
from meshfit.report.trial_meshes import trial_meshes

_UNITS = {
    "tutorial": "in the tutorial frame, where the target's largest |coordinate| is 1",
    "box": "in the box frame, where the diagonal of the target's box is 1",
    "none": "in the unit of the target's file",
}


@dataclass(frozen=True)
class _Found:
    """What is drawn of one thing that was named, and the frame that it is in."""

    shown: tuple[Shown, ...]
    frame: str


def scene_of(what: Sequence[str], against: str | None = None) -> tuple[list[Shown], str]:
    """What is drawn, from left to right, and the label of its colour bar.

    Args:
        what: mesh files, names of targets, or folders of trials, each as itself or as `TITLE=…`.
        against: the target that distances are taken to: a name, or a mesh file.

    Raises:
        ConfigError: distances that would be in different units.
        MeshError, StoreError: what cannot be read.
    """
    target = None if against is None else _named(against)
    files = target
    found = []
    for text in what:
        title, _, name = text.rpartition("=")
        if Path(name).is_dir():
            found.append(_trial(Path(name), title, against))
        else:
            one = _mesh(name, title, files, target)
            files = files if files is not None or name in NAMED_TARGETS else one.mesh
            found.append(_Found((one,), _frame(against or name)))
    frames = dict.fromkeys(each.frame for each in found) if against is not None else {}
    if len(frames) > 1:
        raise ConfigError(f"distances cannot share a scale: some are {', others '.join(_UNITS[one] for one in frames)}")
    label = f"distance to {target_title(against)}, {_UNITS[next(iter(frames))]}" if against is not None else ""
    return [shown for each in found for shown in each.shown], label


def _frame(name: str) -> str:
    return "tutorial" if name in NAMED_TARGETS else "none"


def _named(name: str) -> Mesh:
    """A mesh by its name or file; a named target in its tutorial frame, a file as it is."""
    mesh = load_target(name)
    return frame_of(mesh.verts, "tutorial").normalise(mesh) if name in NAMED_TARGETS else mesh


def _mesh(name: str, title: str, files: Mesh | None, target: Mesh | None) -> Shown:
    mesh = _named(name)
    own = target is None and name in NAMED_TARGETS
    return Shown(title or target_title(name), mesh, mesh if own or files is None else files, target)


def _trial(folder: Path, title: str, against: str | None) -> _Found:
    """A trial's source and target are plain, whatever its result is compared with: neither is a result."""
    meshes = trial_meshes(folder)
    name = title or meshes.facts["scheme"]
    wanted = None
    if against is not None:
        same = against == meshes.facts["settings"]["targets"][0]
        wanted = meshes.target if same else meshes.frame.normalise(load_target(against))
    return _Found(
        (
            Shown(f"source, {name}", meshes.source, meshes.target),
            Shown(f"result, {name}", meshes.result, meshes.target, wanted),
            Shown(meshes.facts["target_title"], meshes.target, meshes.target),
        ),
        meshes.facts["settings"].get("normalise", "tutorial"),
    )
