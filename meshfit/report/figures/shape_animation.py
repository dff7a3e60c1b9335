"""Animations from shape to shape: results of trials or mesh files with the same faces, and the shapes in between."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from meshfit.experiment.storage.plan_file import UpChoice
from meshfit.experiment.storage.run_directory import RESULT, read_json
from meshfit.mesh.any_mesh import as_mesh
from meshfit.mesh.geometry import nearest_rotations
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.shape_interpolation import ShapeInterpolation, require_same_faces
from meshfit.mesh.targets import target_title
from meshfit.paths import file_stem
from meshfit.report.figures.animation import Animation, AnimationFrame
from meshfit.report.figures.render import RenderedMesh, RenderStyle, write_render
from meshfit.report.figures.trial_meshes import FITTED, SOURCE, read_normalised


@dataclass(frozen=True)
class NamedShape:
    """A shape that an animation leads to.

    Attributes:
        title: in captions.
        mesh: the shape.
    """

    title: str
    mesh: Mesh


@dataclass(frozen=True)
class ShapeStep:
    """A shape on the way.

    Attributes:
        mesh: the shape.
        before: title of the shape that it comes from.
        after: title of the one that it leads to.
        share: of the way, 0 to 1.
    """

    mesh: Mesh
    before: str
    after: str
    share: float

    @property
    def caption(self) -> str:
        """Where it is on the way."""
        if self.share in (0, 1):
            return self.after if self.share else self.before
        return f"{self.before} to {self.after}  ·  {self.share:.0%}"


def shape_of_file(path: Path) -> NamedShape:
    """Return the shape of a mesh file, in its own coordinates.

    Raises:
        MeshError: it cannot be read.
    """
    return NamedShape(file_stem(str(path)), as_mesh(path, str(path), triangles=True))


def shapes_of_trial(folder: Path) -> tuple[NamedShape, NamedShape]:
    """Return the source and the result of a complete trial in its normalised frame, titled by source and target.

    Raises:
        StoreError: `result.json` cannot be read.
        MeshError: the mesh cannot be read.
    """
    facts = read_json(folder / RESULT)
    titles = facts["settings"]["source"]["mesh"], facts["settings"]["targets"][0]
    source, result = (
        NamedShape(target_title(title), read_normalised(folder / name, facts))
        for title, name in zip(titles, (SOURCE, FITTED), strict=True)
    )
    return source, result


def aligned(shapes: Sequence[NamedShape]) -> list[NamedShape]:
    """Return shapes with the position, rotation and size of the first, by all vertices (Umeyama 1991)."""
    first = shapes[0].mesh.verts
    goal = first - first.mean(axis=0)
    result = [shapes[0]]
    for shape in shapes[1:]:
        arms = shape.mesh.verts - shape.mesh.verts.mean(axis=0)
        rotation = nearest_rotations((arms.T @ goal)[None] / max(float((arms**2).sum()), 1e-300))[0]
        turned = arms @ rotation.T
        scale = float((turned * goal).sum()) / max(float((arms**2).sum()), 1e-300)
        result.append(replace(shape, mesh=shape.mesh.with_verts(scale * turned + first.mean(axis=0))))
    return result


def steps_between(shapes: Sequence[NamedShape], count: int, *, back: bool = False) -> Iterator[ShapeStep]:
    """Return the shapes, and those in between.

    Args:
        shapes: at least two, with the same faces.
        count: number of steps from each to the next.
        back: return to the first in the end.

    Raises:
        MeshError: their faces differ.
    """
    require_same_faces([shape.mesh for shape in shapes], [shape.title for shape in shapes])
    stops = [*shapes, *reversed(shapes[:-1])] if back else list(shapes)
    for place, (before, after) in enumerate(pairwise(stops)):
        way = ShapeInterpolation(before.mesh, before.mesh.with_verts(after.mesh.verts))
        for number in range(1 if place else 0, count + 1):
            share = number / count
            yield ShapeStep(way.at(share), before.title, after.title, share)


def shape_animation(steps: Sequence[ShapeStep], up: UpChoice, view: str) -> Animation:
    """Return the animation of shapes, from the camera of the first."""
    frames = tuple(AnimationFrame(step.mesh, step.caption) for step in steps)
    return Animation(frames[0].mesh, frames, up, view)


def write_row(steps: Sequence[ShapeStep], path: Path, *, size: int, up: UpChoice, view: str, edges: bool) -> None:
    """Write a picture of the shapes in one row.

    Raises:
        ConfigError: a library is not installed, or the picture cannot be written.
    """
    first = steps[0].mesh
    meshes = [
        RenderedMesh(step.caption if step.share in (0, 1) else f"{step.share:.0%}", step.mesh, first) for step in steps
    ]
    write_render(meshes, path, style=RenderStyle(edges, (size, size), len(steps), view, up))


def write_meshes(steps: Sequence[ShapeStep], folder: Path) -> None:
    """Write the shapes as `shape-000.ply`, `shape-001.ply` and so on.

    Raises:
        MeshError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    digits = max(3, len(str(len(steps) - 1)))
    for number, step in enumerate(steps):
        save_mesh(step.mesh, folder / f"shape-{number:0{digits}d}.ply")
