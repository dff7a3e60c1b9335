"""The meshes of the trials that a wall shows, as far as their files are still there."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError, MeshfitError
from meshfit.mesh.files import load_mesh
from meshfit.mesh.frames import Frame
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.targets import file_sha256, load_target, target_path
from meshfit.report.gather import Result
from meshfit.report.page.exhibits import Exhibit, Wall
from meshfit.report.surface_errors import distances_to


@dataclass(frozen=True)
class Subject:
    """The meshes of one exhibit, in the frame that its numbers are stated in.

    Attributes:
        exhibit: which one.
        source: the source mesh.
        result: the fitted mesh.
        distances: (V,) from each vert of the result to the target; None where there is no target to measure to.
    """

    exhibit: Exhibit
    source: Mesh
    result: Mesh
    distances: Float64[np.ndarray, " V"] | None


@dataclass(frozen=True)
class Subjects:
    """What a wall can be drawn of.

    Attributes:
        wall: which one.
        target: the target; None where it is gone, or is no longer what it was.
        shown: the exhibits whose meshes could be read.
        problems: what could not be read, and why, a line each.
    """

    wall: Wall
    target: Mesh | None
    shown: tuple[Subject, ...]
    problems: tuple[str, ...]


def subjects_of(wall: Wall) -> Subjects:
    """Read the meshes of a wall; what cannot be read is told, and the rest is kept."""
    problems: list[str] = []
    target = _target(wall.exhibits[0].result, problems)
    shown = tuple(_subjects(wall, target, problems))
    return Subjects(wall, target, shown, tuple(problems))


def _target(result: Result, problems: list[str]) -> Mesh | None:
    name = result["settings"]["targets"][0]
    try:
        path, known = target_path(name), result.get("inputs", {}).get("target")
        if path is not None and known is not None and path.is_file() and file_sha256(path) != known:
            raise MeshError(f"{path}: not the file that the trial was fitted to: it has changed since")
        return _frame(result).normalise(load_target(name))
    except MeshfitError as error:
        problems.append(f"The target is not shown, and distances to it are not drawn: {error}")
        return None


def _subjects(wall: Wall, target: Mesh | None, problems: list[str]) -> Iterator[Subject]:
    for exhibit in wall.exhibits:
        try:
            source, result = _fitted(exhibit)
            distances = distances_to(result, target) if target is not None else None
        except MeshfitError as error:
            problems.append(f"{exhibit.label}, seed {exhibit.seed}, is not shown: {error}")
            continue
        yield Subject(exhibit, source, result, distances)


def _fitted(exhibit: Exhibit) -> tuple[Mesh, Mesh]:
    source, result = (load_mesh(exhibit.folder / name) for name in ("source.ply", "result.ply"))
    if not result.num_faces:
        raise MeshError(f"{exhibit.folder / 'result.ply'}: no faces")
    if exhibit.result["settings"].get("write_frame") == "target":
        frame = _frame(exhibit.result)
        return frame.normalise(source), frame.normalise(result)
    return source, result


def _frame(result: Result) -> Frame:
    found = result["frame"]
    return Frame(tuple(found["centre"]), found["scale"])
