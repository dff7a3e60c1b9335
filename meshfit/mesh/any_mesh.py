"""Meshes in any form: one function that takes meshes of other libraries, arrays, paths and names."""

import os
from pathlib import Path
from typing import Any, Literal, Protocol, TypeAlias, overload, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshfit.doors import no_type_check
from meshfit.errors import MeshError
from meshfit.mesh.curves import Chains, Curves
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.paths import looks_like_path
from meshfit.printable import described
from meshfit.specs import suggest

_ALLOWED = (
    "a Mesh, a PolygonMesh, a pair (verts, faces), a trimesh or pyvista mesh, the path of a mesh file, or a target's "
    "name"
)
# By the end of a class's name: what to call on an object of it to get a surface.
_REMEDIES = {
    "Scene": "give its to_mesh()",
    "PointCloud": "it has no faces; fit a surface to it first: meshfit.fit('auto', points, method='gauss-newton')",
    "UnstructuredGrid": "give its extract_surface()",
    "StructuredGrid": "give its extract_surface()",
    "ImageData": "give its extract_surface()",
    "MultiBlock": "give one of its blocks",
    "Curves": "curves have no faces",
    "Problem": "give its source or its target",
    "Refinement": "give its faces with verts, as (verts, refinement.faces)",
}


@runtime_checkable
class VerticesAndFaces(Protocol):
    """A mesh such as trimesh's: (V, 3) `vertices` and (F, 3) `faces`."""

    @property
    def vertices(self) -> Any:  # noqa: ANN401  the arrays of another library
        """(V, 3) positions."""

    @property
    def faces(self) -> Any:  # noqa: ANN401  the arrays of another library
        """(F, 3) vertex numbers."""


@runtime_checkable
class PointsAndFaces(Protocol):
    """A mesh such as pyvista's: (V, 3) `points`, and `faces` in one flat array, each after its number of corners."""

    @property
    def points(self) -> Any:  # noqa: ANN401  the arrays of another library
        """(V, 3) positions."""

    @property
    def faces(self) -> Any:  # noqa: ANN401  the arrays of another library
        """Numbers of corners and vertex numbers, flat."""


@runtime_checkable
class HasMesh(Protocol):
    """A result with a mesh, such as `FitResult`."""

    @property
    def mesh(self) -> Mesh:
        """The mesh."""


Rows: TypeAlias = ArrayLike | list[list[int]] | list[tuple[int, ...]]
MeshLike: TypeAlias = (
    Mesh
    | PolygonMesh
    | HasMesh
    | VerticesAndFaces
    | PointsAndFaces
    | str
    | os.PathLike[str]
    | tuple[ArrayLike, Rows]
    | list[Any]
)
"""Everything that `as_mesh` takes."""


@overload
def as_mesh(thing: "MeshLike", role: str = "mesh", *, triangles: Literal[True]) -> Mesh: ...
@overload
def as_mesh(thing: "MeshLike", role: str = "mesh", *, triangles: bool = False) -> Mesh | PolygonMesh: ...
@no_type_check
def as_mesh(thing: "MeshLike", role: str = "mesh", *, triangles: bool = False) -> Mesh | PolygonMesh:
    """Return a mesh in any form as a `Mesh`, or as a `PolygonMesh` where faces have more than three corners.

    Every function of meshfit that takes a mesh takes all that this takes. Vertices stay in their order, and are not
    welded; files are read and cleaned as by `load_mesh`.

    Args:
        thing: a `Mesh`, a `PolygonMesh` or a `FitResult`; a pair (verts, faces) of arrays, lists or tensors, with
            (F, N) vertex numbers or rows of various lengths as faces; a mesh of trimesh, pyvista or Open3D; the path
            of a mesh file; or the name of a target or a solid, such as `bunny` or `icosahedron`.
        role: name of the mesh in error messages.
        triangles: triangulate polygons.

    Example:
        >>> import meshfit
        >>> meshfit.as_mesh(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
        Mesh(3 verts, 1 face, box 1 × 1 × 0)
        >>> meshfit.as_mesh("cube")
        PolygonMesh(8 verts, 6 quads, box 1.155 × 1.155 × 1.155)

    Raises:
        MeshError: anything else, arrays of a wrong shape or type, vertex numbers out of range, coordinates of arrays
            that are not finite, or a file that cannot be read.
    """
    if not isinstance(role, str):
        raise MeshError(f"role: expected the name of the mesh in messages, got {described(role)}")
    if not isinstance(triangles, bool | np.bool_):
        raise MeshError(f"triangles: expected True or False, got {described(triangles)}; faces go with their vertices")
    mesh = _as_mesh(thing, role)
    if triangles and isinstance(mesh, PolygonMesh):
        if isinstance(thing, str) and thing in _solids():
            solid: Mesh = _solids()[thing]()
            return solid
        return mesh.triangulated()
    return mesh


@overload
def as_topology(thing: "MeshLike | Topology") -> Topology | PolygonTopology: ...
@overload
def as_topology(thing: Curves | Chains) -> Chains: ...
@overload
def as_topology(
    thing: "MeshLike | Topology | PolygonTopology | Curves | Chains",
) -> Topology | PolygonTopology | Chains: ...
@no_type_check
def as_topology(
    thing: "MeshLike | Topology | PolygonTopology | Curves | Chains",
) -> Topology | PolygonTopology | Chains:
    """Return the connectivity of a mesh in any form that `as_mesh` takes, or of curves; connectivity stays as it is.

    Raises:
        MeshError: as `as_mesh` does.
    """
    if isinstance(thing, Topology | PolygonTopology | Chains):
        return thing
    if isinstance(thing, Curves):
        return Chains.of(thing)
    mesh = as_mesh(thing)
    return Topology.of(mesh) if isinstance(mesh, Mesh) else PolygonTopology.of(mesh)


def _as_mesh(thing: Any, role: str) -> Mesh | PolygonMesh:  # noqa: ANN401  anything that callers may give
    if isinstance(thing, Mesh | PolygonMesh):
        _require_in_range(thing, role)
        return thing
    if isinstance(thing, str | os.PathLike):
        return _loaded(os.fspath(thing), role)
    if isinstance(thing, tuple | list):
        if len(thing) != 2 or any(isinstance(part, str) for part in thing):
            found = f"a {type(thing).__name__} of {', '.join(type(part).__name__ for part in thing[:4]) or 'nothing'}"
            raise MeshError(f"{role}: expected a pair (verts, faces), got {found}")
        return _of_arrays(thing[0], thing[1], role)
    of_result, polygons = getattr(thing, "mesh", None), getattr(thing, "polygons", None)
    if isinstance(of_result, Mesh):
        return polygons if isinstance(polygons, PolygonMesh) else of_result
    return _of_foreign(thing, role)


def _loaded(name: str, role: str) -> Mesh | PolygonMesh:
    from meshfit.mesh.solids import POLYGON_SOLIDS
    from meshfit.mesh.targets import NAMED_TARGETS, load_target_with_vertex_map  # reads formats; arrays need none

    if name in _solids():
        solid: Mesh | PolygonMesh = POLYGON_SOLIDS.get(name, _solids()[name])()
        return solid
    if name and name not in NAMED_TARGETS and not looks_like_path(name) and not os.path.lexists(name):
        names = [*(["sphere"] if role == "source" else []), *_solids(), *NAMED_TARGETS]
        raise MeshError(f"{role}: '{name}' is neither a name nor a file: {suggest(name, names)}, or the path of a file")
    mesh, _ = load_target_with_vertex_map(name, polygons=True)
    return _triangles_if_all_are(PolygonMesh.of(mesh))


def _solids() -> dict[str, Any]:
    from meshfit.mesh.solids import SOLIDS

    return dict(SOLIDS)


def _of_foreign(thing: Any, role: str) -> Mesh | PolygonMesh:  # noqa: ANN401  a mesh of another library
    verts, faces = getattr(thing, "vertices", None), getattr(thing, "faces", None)
    if verts is not None and not callable(verts):
        faces = getattr(thing, "triangles", None) if faces is None else faces  # Open3D
        if faces is not None and not callable(faces):
            return _of_arrays(verts, faces, role)
    verts = getattr(thing, "points", None)
    if verts is not None and faces is not None and not callable(faces):
        corners, sizes = _of_padded(np.asarray(faces), role)
        return _triangles_if_all_are(_checked(_positions(verts, role), corners, sizes, role))
    raise MeshError(f"{role}: expected {_ALLOWED}; got {_described_mesh(thing)}")


def _of_padded(padded: NDArray[Any], role: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Split pyvista's flat array of faces, each after its number of corners."""
    values, sizes = padded.reshape(-1).astype(np.int64), list[int]()
    is_corner, at = np.ones(len(values), dtype=bool), 0
    if len(values) and len(values) % (step := int(values[0]) + 1) == 0 and (values[::step] == values[0]).all():
        is_corner[::step] = False
        return values[is_corner], values[::step]
    while at < len(values):
        sizes.append(int(values[at]))
        is_corner[at] = False
        at += sizes[-1] + 1
    if at != len(values):
        raise MeshError(f"{role}: faces: expected each face after its number of corners, as pyvista has them")
    return values[is_corner], np.array(sizes, dtype=np.int64)


def _of_arrays(verts: Any, faces: Any, role: str) -> Mesh | PolygonMesh:  # noqa: ANN401  arrays, lists or tensors
    rows = _array(faces)
    if rows is not None and rows.size and rows.dtype.kind == "f":
        points = _array(verts)
        swapped = points is not None and points.dtype.kind in "iu" and points.ndim == 2
        remedy = "; verts and faces look swapped: give (verts, faces)" if swapped else ""
        raise MeshError(f"{role}: faces: expected vertex numbers, which are integers, got {rows.dtype}{remedy}")
    points = _positions(verts, role)
    if rows is None:
        return _triangles_if_all_are(_checked(points, *_of_ragged(faces, role), role))
    if not rows.size:
        return Mesh(points, [])
    if rows.ndim != 2 or rows.dtype.kind not in "iu":
        found = f"an array of shape {rows.shape} and type {rows.dtype}"
        raise MeshError(f"{role}: faces: expected rows of vertex numbers, (F, 3) integers for triangles, got {found}")
    if rows.shape[1] == 3:
        mesh = Mesh(points, rows)
        _require_in_range(mesh, role)
        return mesh
    return _checked(points, rows.reshape(-1), np.full(len(rows), rows.shape[1]), role)


def _positions(values: Any, role: str) -> NDArray[np.float64]:  # noqa: ANN401  an array, a list or a tensor
    points = _array(values)
    if points is None or points.dtype.kind not in "fiu":
        found = "rows of various lengths" if points is None else f"an array of type {points.dtype}"
        raise MeshError(f"{role}: verts: expected rows of three numbers, got {found}")
    if points.ndim != 2 or points.shape[1] != 3:
        remedy = "; add a third column of zeros" if points.ndim == 2 and points.shape[1] == 2 else ""
        raise MeshError(f"{role}: verts: expected rows of three numbers, got an array of shape {points.shape}{remedy}")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise MeshError(f"{role}: vertex {int(np.flatnonzero(~finite)[0])} has a coordinate that is not finite")
    return points.astype(np.float64)


def _array(values: Any) -> NDArray[Any] | None:  # noqa: ANN401  an array, a list or a tensor
    """Return values as an array; None where rows differ in length."""
    if hasattr(values, "detach"):  # a tensor, perhaps on a GPU, perhaps with gradients
        values = values.detach().cpu()
    try:
        return np.asarray(values)
    except ValueError:
        return None


def _of_ragged(faces: Any, role: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:  # noqa: ANN401  rows of any kind
    rows = [_array(face) for face in faces]
    for number, row in enumerate(rows):
        if row is None or row.ndim != 1 or row.dtype.kind not in "iu":
            raise MeshError(f"{role}: face {number}: expected a row of vertex numbers, got {faces[number]!r:.60}")
    sizes = np.array([len(row) for row in rows if row is not None], dtype=np.int64)
    return np.concatenate([row for row in rows if row is not None]).astype(np.int64), sizes


def _checked(verts: NDArray[np.float64], corners: ArrayLike, sizes: ArrayLike, role: str) -> PolygonMesh:
    try:
        mesh = PolygonMesh(verts, corners, sizes)
    except MeshError as error:
        raise MeshError(f"{role}: {error}") from None
    _require_in_range(mesh, role)
    return mesh


def _require_in_range(mesh: Mesh | PolygonMesh, role: str) -> None:
    corners = mesh.faces.reshape(-1) if isinstance(mesh, Mesh) else mesh.corners
    if not len(corners) or (corners.min() >= 0 and corners.max() < mesh.num_verts):
        return
    at = int(np.flatnonzero((corners < 0) | (corners >= mesh.num_verts))[0])
    face = at // 3 if isinstance(mesh, Mesh) else int(np.searchsorted(mesh.starts, at, side="right")) - 1
    from_one = corners.min() == 1 and corners.max() == mesh.num_verts
    remedy = "; yours begin at 1: subtract 1" if from_one else ""
    numbered = f"vertices are numbered 0 to {mesh.num_verts - 1}" if mesh.num_verts else "there are no vertices"
    raise MeshError(f"{role}: face {face} has vertex {corners[at]}, but {numbered}{remedy}")


def _triangles_if_all_are(mesh: PolygonMesh) -> Mesh | PolygonMesh:
    return Mesh(mesh.verts, mesh.corners.reshape(-1, 3), mesh.attributes) if (mesh.sizes == 3).all() else mesh


@no_type_check
def _described_mesh(thing: Any) -> str:  # noqa: ANN401  anything that callers may give
    """Return what a thing is that is no mesh, and how to make a mesh of it, where that is known."""
    name, kind = described(thing), type(thing).__name__
    if isinstance(thing, dict):
        return f"{name} ({', '.join(str(key) for key in list(thing)[:4])}); give (verts, faces)"
    remedy = _REMEDIES.get("Refinement" if kind.endswith("Refinement") else kind)
    if remedy:
        return f"{name}; {remedy}"
    return f"{name}; give it with its faces, as (verts, faces)" if name.startswith("an array") else name


def as_path(path: Any, order: str = "", *, role: str = "path") -> str | Path:  # noqa: ANN401  anything that callers may give
    """Return the path of a file.

    Args:
        path: a path, or anything else by mistake.
        order: the right order of the arguments, such as `save_mesh(mesh, path)`, where others have it wrong.
        role: name of the path in error messages.

    Raises:
        MeshError: not a path.
    """
    if isinstance(path, str | os.PathLike):
        text = os.fspath(path)
        if isinstance(text, str):
            return path if isinstance(path, str | Path) else text
    advice = f"; the order is {order}" if order else ""
    raise MeshError(f"{role}: expected the path of a file, got {described(path)}{advice}")
