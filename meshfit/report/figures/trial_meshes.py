"""The meshes of a trial: its source, its result and its target, in the one frame that its numbers are stated in."""

from dataclasses import dataclass
from pathlib import Path

from meshfit.errors import StoreError
from meshfit.experiment.storage.run_directory import RESULT, Result, read_json
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.targets import load_target


@dataclass(frozen=True)
class TrialMeshes:
    """What a trial began with, what it came to, and what it aimed at, all in its normalised frame.

    Attributes:
        facts: the content of its `result.json`.
        frame: from the target file's coordinates to those of the meshes.
        source: the subdivided source mesh.
        result: the fitted mesh.
        target: the target.
    """

    facts: Result
    frame: Frame
    source: Mesh
    result: Mesh
    target: Mesh


def trial_meshes(folder: Path) -> TrialMeshes:
    """Read the meshes of a complete trial.

    Args:
        folder: of the trial, with `result.json`, `source.ply` and `result.ply`.

    Raises:
        StoreError: `result.json` cannot be read, or does not say what a result says.
        MeshError: a mesh cannot be read, or the target is no longer there.
    """
    facts = read_json(folder / RESULT)
    try:
        across, up, towards = map(float, facts["frame"]["centre"])
        frame = Frame((across, up, towards), float(facts["frame"]["scale"]))
        target, written = facts["settings"]["targets"][0], facts["settings"]["write_frame"]
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise StoreError(f"{folder / RESULT}: not the result of a trial: {error}") from None
    source, result = load_mesh(folder / "source.ply"), load_mesh(folder / "result.ply")
    if written == "target":
        source, result = frame.normalise(source), frame.normalise(result)
    return TrialMeshes(facts, frame, source, result, frame.normalise(load_target(target)))
