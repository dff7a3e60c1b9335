"""The meshes that the page turns: decimated if they are large, with coordinates in 16 bits."""

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.mesh.geometry import bounding_box
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.report.figures.camera import Vector, camera_of
from meshfit.report.figures.surface_errors import distances_to
from meshfit.report.html.images import limit_of
from meshfit.report.html.target_section import Subjects

MOST_FACES = 12_000
_STEPS = 65_535
_ALIGNED = 4


@dataclass(frozen=True)
class Quantised:
    """A mesh in few bytes.

    Attributes:
        low: the least coordinates.
        extent: the largest difference of coordinates, which 65,535 steps stand for.
        wide: whether indices of verts have 32 bits, not 16.
        arrays: the bytes of `verts`, `faces` and, where there are distances, `values`.
    """

    low: tuple[float, float, float]
    extent: float
    wide: bool
    arrays: dict[str, bytes]


@dataclass(frozen=True)
class View:
    """One mesh that can be turned.

    Attributes:
        title: what it is.
        note: how far it was decimated; empty if it was not.
        mesh: its data for the viewer.
    """

    title: str
    note: str
    mesh: Quantised


@dataclass(frozen=True)
class Scene:
    """The views of a wall, which are turned together.

    Attributes:
        views: target, if there is one, and results.
        eye: unit vectors to the right, up and towards the eye of the first view.
        centre: the point that views turn about.
        radius: of what has to fit into a view.
    """

    views: tuple[View, ...]
    eye: tuple[Vector, Vector, Vector]
    centre: Vector
    radius: float

    def content(self) -> bytes:
        """What the viewer needs: the length of a JSON text, that text, and the arrays that it tells the places of."""
        arrays, meshes, begin = [], [], 0
        for view in self.views:
            places = {}
            for name, array in view.mesh.arrays.items():
                places[name] = begin, len(array)
                arrays.append(array + bytes(-len(array) % _ALIGNED))
                begin += len(arrays[-1])
            meshes.append({"low": view.mesh.low, "extent": view.mesh.extent, "wide": view.mesh.wide, "arrays": places})
        head = {"eye": self.eye, "centre": self.centre, "radius": self.radius, "meshes": meshes}
        text = json.dumps(head).encode()
        text += b" " * (-len(text) % _ALIGNED)
        return struct.pack("<I", len(text)) + text + b"".join(arrays)


def scene_of(subjects: Subjects, tick: Callable[[], None]) -> Scene:
    """The scene of a wall; there is at least one subject to show.

    Args:
        subjects: of the wall.
        tick: called after each mesh.
    """
    limit, views = limit_of(subjects), []
    if subjects.target is not None:
        views.append(_view("target", subjects.target, None, limit))
        tick()
    for subject in subjects.shown:
        views.append(_view(subject.exhibit.label, subject.result, subject.distances, limit, subjects.target))
        tick()
    first = subjects.target if subjects.target is not None else subjects.shown[0].result
    verts = np.concatenate([first.verts, *(subject.result.verts for subject in subjects.shown)])
    centre, camera = np.mean(bounding_box(verts), axis=0), camera_of(first)
    return Scene(
        views=tuple(views),
        eye=(camera.right, camera.up, camera.direction),
        centre=(float(centre[0]), float(centre[1]), float(centre[2])),
        radius=float(np.linalg.norm(verts - centre, axis=1).max()) or 1.0,
    )


def _view(
    title: str, mesh: Mesh, distances: Float64[np.ndarray, " V"] | None, limit: float, target: Mesh | None = None
) -> View:
    shown = decimate(mesh, MOST_FACES) if mesh.num_faces > MOST_FACES else mesh
    note = f"{shown.num_faces:,} of {mesh.num_faces:,} faces" if shown is not mesh else ""
    if shown is not mesh and distances is not None and target is not None:
        distances = distances_to(shown, target)
    return View(title, note, quantised(shown, distances, limit))


def quantised(mesh: Mesh, distances: Float64[np.ndarray, " V"] | None, limit: float) -> Quantised:
    """A mesh for the viewer: a coordinate is off by 1/131,070 of the mesh's extent, a distance by 1/510 of `limit`."""
    low, high = bounding_box(mesh.verts)
    extent = float((high - low).max()) or 1.0
    wide = mesh.num_verts > _STEPS
    arrays = {
        "verts": np.rint((mesh.verts - low) / extent * _STEPS).astype("<u2").tobytes(),
        "faces": mesh.faces.astype("<u4" if wide else "<u2").tobytes(),
    }
    if distances is not None:
        arrays["values"] = np.rint(np.clip(distances / limit, 0.0, 1.0) * 255).astype("u1").tobytes()
    return Quantised((float(low[0]), float(low[1]), float(low[2])), extent, wide, arrays)
