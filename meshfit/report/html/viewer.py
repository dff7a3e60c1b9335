"""Data of the 3D viewer: the meshes of a target section, decimated if they are large, with 16-bit coordinates."""

import base64
import gzip
import json
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.mesh.geometry import bounding_box
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.point_cloud import PointCloud
from meshfit.report.figures.camera import Vector, camera_of
from meshfit.report.figures.cloud_surfels import surfels
from meshfit.report.figures.trial_meshes import distances_to
from meshfit.report.html.target_section import TargetSection

MOST_FACES = 12_000
_STEPS = 65_535
_ALIGNED = 4


@dataclass(frozen=True)
class ViewerMesh:
    """A quantised mesh.

    Attributes:
        title: its title.
        note: how far it was decimated; empty if it was not.
        low: the smallest coordinates.
        extent: the largest side of its bounding box, divided into 65,535 steps.
        wide: whether vertex indices have 32 bits rather than 16.
        arrays: the bytes of `verts`, `faces` and, with distances, `values`.
    """

    title: str
    note: str
    low: Vector
    extent: float
    wide: bool
    arrays: dict[str, bytes]


def viewer_meshes(section: TargetSection) -> Iterator[ViewerMesh]:
    """Quantise the target and the results of a section, in the order of the page."""
    if section.target is not None and section.trials:
        small, note = _small_target(section.target)
        yield quantise(small, None, section.limit, "target", note)
    for trial in section.trials:
        yield viewer_mesh(trial.mesh, trial.distances, section.limit, trial.label, section.measured_to)


def viewer_mesh(
    mesh: Mesh, distances: Float64[np.ndarray, " V"] | None, limit: float, title: str, target: Mesh | None
) -> ViewerMesh:
    """Decimate a mesh if it is large, with its distances to the target, if any, and quantise it."""
    small, note = _decimated(mesh)
    if small is not mesh and target is not None:
        distances = distances_to(small, target)
    return quantise(small, distances, limit, title, note)


def viewer_cloud(cloud: PointCloud, limit: float, title: str) -> ViewerMesh:
    """Quantise the points of a cloud as triangles; of many, some."""
    small, note = _small_target(cloud)
    return quantise(small, None, limit, title, note)


def viewer_scene(section: TargetSection, meshes: Sequence[ViewerMesh]) -> bytes:
    """Pack the meshes of a section, which has at least one, with the view that they share."""
    first = section.first_mesh
    assert first is not None  # noqa: S101  the section has meshes
    verts = np.concatenate([first.verts, *(trial.mesh.verts for trial in section.trials)])
    centre, camera = np.mean(bounding_box(verts), axis=0), camera_of(first, section.up)
    return pack_scene(
        meshes,
        axes=(camera.right, camera.up, camera.direction),
        centre=(float(centre[0]), float(centre[1]), float(centre[2])),
        radius=float(np.linalg.norm(verts - centre, axis=1).max()) or 1.0,
    )


def pack_scene(
    meshes: Sequence[ViewerMesh], axes: tuple[Vector, Vector, Vector], centre: Vector, radius: float
) -> bytes:
    """Pack meshes as the length of a JSON text (32 bits), that text, and the arrays whose offsets it contains.

    Args:
        meshes: the meshes.
        axes: unit vectors right, up and towards the eye of the first view.
        centre: the point that views turn about.
        radius: radius of the ball that has to fit into a view.
    """
    arrays, heads, begin = [], [], 0
    for mesh in meshes:
        places = {}
        for name, array in mesh.arrays.items():
            places[name] = begin, len(array)
            arrays.append(array + bytes(-len(array) % _ALIGNED))
            begin += len(arrays[-1])
        heads.append({"low": mesh.low, "extent": mesh.extent, "wide": mesh.wide, "arrays": places})
    text = json.dumps({"axes": axes, "centre": centre, "radius": radius, "meshes": heads}).encode()
    text += b" " * (-len(text) % _ALIGNED)
    return struct.pack("<I", len(text)) + text + b"".join(arrays)


def quantise(
    mesh: Mesh, distances: Float64[np.ndarray, " V"] | None, limit: float, title: str = "", note: str = ""
) -> ViewerMesh:
    """Quantise a mesh: coordinates to within 1/131,070 of its extent, distances to within 1/510 of `limit`."""
    low, high = bounding_box(mesh.verts)
    extent = float((high - low).max()) or 1.0
    wide = mesh.num_verts > _STEPS
    arrays = {
        "verts": np.rint((mesh.verts - low) / extent * _STEPS).astype("<u2").tobytes(),
        "faces": mesh.faces.astype("<u4" if wide else "<u2").tobytes(),
    }
    if distances is not None:
        arrays["values"] = np.rint(np.clip(distances / limit, 0.0, 1.0) * 255).astype("u1").tobytes()
    return ViewerMesh(title, note, (float(low[0]), float(low[1]), float(low[2])), extent, wide, arrays)


def _small_target(target: Mesh | PointCloud) -> tuple[Mesh, str]:
    """A target of at most `MOST_FACES` faces, one for each point of a cloud, and a note if it was reduced."""
    if not isinstance(target, PointCloud):
        return _decimated(target)
    small = surfels(target, MOST_FACES, corners=3)
    return small, f"{small.num_faces:,} of {target.num_verts:,} points" if small.num_faces < target.num_verts else ""


def _decimated(mesh: Mesh) -> tuple[Mesh, str]:
    """A mesh of at most `MOST_FACES` faces, and a note if it was decimated."""
    if mesh.num_faces <= MOST_FACES:
        return mesh, ""
    small = decimate(mesh, MOST_FACES)
    return small, f"{small.num_faces:,} of {mesh.num_faces:,} faces"


def compress(content: bytes) -> str:
    """Return bytes as text that the page can embed: gzip in base64; equal bytes give equal text."""
    return base64.b64encode(gzip.compress(content, compresslevel=9, mtime=0)).decode()
