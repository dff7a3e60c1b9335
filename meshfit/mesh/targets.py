"""Named targets: meshes that a config can name, with their origin and the hash of the expected file."""

import hashlib
import importlib.util
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar, overload

from meshfit.doors import no_type_check
from meshfit.errors import MeshError, MeshfitWarning, NoFacesError
from meshfit.memory import require_memory
from meshfit.mesh.io.mesh_file import MeshFile, read_file
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.paths import (
    MESH_SUFFIXES,
    STREAM,
    bundled_folder,
    file_stem,
    format_suffix,
    is_pipe,
    is_regular_file,
    looks_like_path,
    not_a_file_message,
    path_text,
    quoted_path,
    read_error_message,
    similar_file,
)
from meshfit.printable import described
from meshfit.specs import suggest
from meshfit.units import count_text

if TYPE_CHECKING:
    from meshfit.mesh.cleaning import VertexMap
    from meshfit.mesh.cleaning_options import CleaningOptions
    from meshfit.mesh.point_cloud import PointCloud


@dataclass(frozen=True)
class NamedTarget:
    """A mesh known by name.

    Attributes:
        file: the file's name.
        sha256: of the file's content; other content is refused, since numbers are compared across machines.
        bundled: whether meshfit includes the file; the others come with the pymeshlab wheel.
        title: name in tables and captions.
        origin: of the shape.
    """

    file: str
    sha256: str
    bundled: bool
    title: str
    origin: str


# A mesh in which faces use a smaller share of the vertices is a cloud with stray faces.
_STRAY_FACES = 0.1
_WHEEL = "sample mesh of the pymeshlab wheel"

NAMED_TARGETS: dict[str, NamedTarget] = {
    "bunny": NamedTarget(
        "bunny.obj",
        "37574b0008f96cd098bac287d6b77ffea7b1e79df93daf7054680e0e93395857",
        bundled=False,
        title="bunny",
        origin=f"Stanford bunny, closed; {_WHEEL}",
    ),
    "mousehead": NamedTarget(
        "mousehead.ply",
        "2bcc230837a2ba39d8b90b275b345e8670125d0333946f4bd659a5217746cc95",
        bundled=True,
        title="mousehead (stand-in)",
        origin="stand-in for the paper's model, which is not public; made by data/mousehead.py",
    ),
    "cow": NamedTarget(
        "cow.obj",
        "5ffe2216718b5a015da18c0be206ca2328f345c995fb815d72b2b92e65c54fe8",
        bundled=False,
        title="cow",
        origin=f"{_WHEEL}; 89 of its faces intersect others",
    ),
    "bone": NamedTarget(
        "bone.ply",
        "c87b0904ba21e55abe5c9c04a65e8933d6bac91e062b26faaf05eddc850c561a",
        bundled=False,
        title="bone",
        origin=f"{_WHEEL}; 359 vertices that no face uses are dropped",
    ),
    "airplane": NamedTarget(
        "airplane.obj",
        "25a04c44e599290d225f3667d7b2c48cf0bda68583c84649872725ac6b822eb1",
        bundled=False,
        title="airplane",
        origin=_WHEEL,
    ),
}

_Loaded = TypeVar("_Loaded")


def target_path(target: str) -> Path:
    """Return the file of a target.

    Args:
        target: a name of `NAMED_TARGETS`, or a path; anything with a suffix or a separator is a path.

    Raises:
        MeshError: neither a known name nor a file, a pipe or standard input, which can be read only once, or a named
            target whose file is missing or not the expected one.
    """
    named = NAMED_TARGETS.get(target)
    if named is not None:
        return _verified(target, named)
    if target == STREAM:
        raise MeshError("standard input can be read only once; save it to a file, and give that")
    path = Path(target)
    if is_regular_file(path):
        return path
    if looks_like_path(target) or not target or os.path.lexists(path):
        raise MeshError(f"{path_text(target)}: {not_a_file_message(target, MESH_SUFFIXES)}")
    similar = similar_file(path, MESH_SUFFIXES)
    or_file = quoted_path(similar) if similar is not None else "the path of a mesh file"
    raise MeshError(
        f"{quoted_path(target)} is neither a target nor a file: {suggest(target, NAMED_TARGETS)}, or {or_file}"
    )


def open_target(
    target: str, kind: Literal["mesh", "curve"] = "mesh", file_format: str | None = None, *, points: bool = False
) -> MeshFile:
    """Read the file of a target once; with a format, a pipe or `-` for standard input as well.

    Args:
        target: as for `target_path`.
        kind: of the file's content.
        file_format: the format, such as `ply`, in place of the suffix.
        points: as for `open_mesh_file`.

    Raises:
        MeshError: as `target_path` and `open_mesh_file` do.
    """
    from meshfit.mesh.io.files import open_mesh_file  # imports scipy, which a list of names does not need

    is_stream = target not in NAMED_TARGETS and (target == STREAM or is_pipe(target))
    return open_mesh_file(target if is_stream else target_path(target), kind, file_format, points=points)


@overload
def load_target(
    target: Literal["bunny", "mousehead", "cow", "bone", "airplane"],
    cleaning: "CleaningOptions | None" = None,
    *,
    file: None = None,
    attributes: bool = False,
) -> Mesh: ...
@overload
def load_target(
    target: str | Path,
    cleaning: "CleaningOptions | None" = None,
    *,
    file: MeshFile | None = None,
    attributes: bool = False,
) -> "Mesh | PointCloud": ...
@no_type_check
def load_target(
    target: str | Path,
    cleaning: "CleaningOptions | None" = None,
    *,
    file: MeshFile | None = None,
    attributes: bool = False,
) -> "Mesh | PointCloud":
    """Load a target, by name or path, in its own coordinates; its shape alone, as fits and measurements need no more.

    A file of points alone gives a `PointCloud`, as `load_point_cloud` reads it; so does a mesh file in which faces use
    less than a tenth of the vertices.

    Args:
        target: as for `target_path`.
        cleaning: distance of welding, and repair of what is not manifold; without effect on points.
        file: its file, if `open_target` has read it already.
        attributes: read texture coordinates, colours, materials and the like too.

    Example:
        >>> import meshfit
        >>> meshfit.load_target("bone")
        Mesh(1,513 verts, 3,022 faces, box 0.9493 × 0.1923 × 0.4345)

    Raises:
        MeshError: as `target_path`, `load_mesh` and `load_point_cloud` do.
    """
    from meshfit.mesh.any_mesh import as_path

    if file is not None and not isinstance(file, MeshFile):
        raise MeshError(f"file: expected a file that has been read, got {described(file)}; give its path as the target")
    name = target if isinstance(target, str) else os.fspath(as_path(target, role="target"))
    return _load(name, file, lambda path: _mesh_or_points(path, cleaning, attributes=attributes))


def load_target_with_vertex_map(
    target: str,
    cleaning: "CleaningOptions | None" = None,
    *,
    polygons: bool,
    file: MeshFile | None = None,
    attributes: bool = True,
) -> tuple[Mesh | PolygonMesh, "VertexMap"]:
    """Load a target as triangles or with the faces of its file, with its attributes and its vertex map.

    Arguments are those of `load_target`.

    Raises:
        MeshError: as `target_path` and `load_mesh_with_vertex_map` do.
    """
    from meshfit.mesh.io.files import load_mesh_with_vertex_map, load_polygons_with_vertex_map

    load: Callable[..., tuple[Mesh | PolygonMesh, VertexMap]] = (
        load_polygons_with_vertex_map if polygons else load_mesh_with_vertex_map
    )
    return _load(target, file, lambda path: load(path, cleaning, attributes=attributes))


@no_type_check
def _mesh_or_points(
    path: Path | MeshFile, cleaning: "CleaningOptions | None", *, attributes: bool
) -> "Mesh | PointCloud":
    from meshfit.mesh.io.files import POINT_FORMATS, load_mesh_with_vertex_map, open_mesh_file
    from meshfit.mesh.io.point_clouds import load_point_cloud
    from meshfit.mesh.topology import NONE

    file = path if isinstance(path, MeshFile) else open_mesh_file(path, "mesh", points=True)
    if file.suffix in POINT_FORMATS:
        return load_point_cloud(file)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshfitWarning)
        try:
            loaded = load_mesh_with_vertex_map(file, cleaning, attributes=attributes)
        except NoFacesError:
            loaded = None
    if loaded is None:
        return load_point_cloud(file)
    mesh, vertex_map = loaded
    used = int((vertex_map.first != NONE).sum())
    if used < _STRAY_FACES * vertex_map.num_file_verts:
        text = f"its faces use only {used:,} of its {count_text(vertex_map.num_file_verts, 'vertex')}"
        warnings.warn(f"{file.name}: read as points without its faces, as {text}", MeshfitWarning, stacklevel=5)
        return load_point_cloud(file)
    for warning in caught:
        warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    return mesh


def _load(target: str, file: MeshFile | None, load: Callable[[Path | MeshFile], _Loaded]) -> _Loaded:
    with warnings.catch_warnings():
        if target in NAMED_TARGETS:  # its faults are known, and listed in `origin`
            warnings.simplefilter("ignore", MeshfitWarning)
        return load(target_path(target) if file is None else file)


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's content, in hexadecimal; of a glTF file, with the buffers beside it.

    Materials and images in other files are not part of it: no number of a fit depends on them, and neither does a file
    of a trial, which refers to them by their place in the source's file.
    """
    try:
        # What is hashed is also read whole.
        require_memory(path.stat().st_size, f"{path_text(path)}: the file is read whole", "give a smaller file")
        with path.open("rb") as stream:
            sha256 = hashlib.file_digest(stream, "sha256")
        for buffer in companion_files(path):
            sha256.update(buffer.read_bytes())
    except OSError as error:
        raise MeshError(f"{path_text(path)}: {read_error_message(error)}") from error
    return sha256.hexdigest()


def companion_files(path: Path, *, looks: bool = False) -> list[Path]:
    """Return the files in a mesh file's folder or below that loading it reads too: the buffers of a glTF file.

    Args:
        path: of the mesh file.
        looks: return the files of its materials too: MTL files and images, as far as they are there.
    """
    suffix = format_suffix(path)
    if suffix not in ((".gltf", ".glb", ".obj", ".ply") if looks else (".gltf", ".glb")):
        return []
    from meshfit.mesh.io.gltf import gltf_files
    from meshfit.mesh.io.obj import obj_files
    from meshfit.mesh.io.ply import ply_files

    try:
        content = read_file(path, (suffix,), "mesh").content
        if suffix == ".obj":
            return obj_files(content, path.parent)
        return ply_files(content, path.parent) if suffix == ".ply" else gltf_files(content, path.parent, images=looks)
    except MeshError:  # loading the file says what is wrong with it
        return []


def target_title(target: str) -> str:
    """Return the name of a target in tables: the title of a named one, the stem of a file."""
    named = NAMED_TARGETS.get(target)
    return named.title if named else file_stem(target)


def _verified(name: str, named: NamedTarget) -> Path:
    path = (bundled_folder("data") if named.bundled else _wheel_samples()) / named.file
    if not path.is_file():
        remedy = "reinstall meshfit" if named.bundled else "install the pymeshlab version that constraints.txt names"
        raise MeshError(f"target '{name}': {path} is missing; {remedy}, or give the path of a mesh file")
    sha256 = file_sha256(path)
    if sha256 != named.sha256:
        raise MeshError(
            f"target '{name}': {path} is not the expected file "
            f"(expected sha256 {named.sha256[:12]}…, got {sha256[:12]}…)"
        )
    return path


def _wheel_samples() -> Path:
    """Return the folder of pymeshlab's sample meshes, without importing it."""
    spec = importlib.util.find_spec("pymeshlab")
    if spec is None or spec.origin is None:
        raise MeshError("the named targets come with pymeshlab, which is not installed: pip install pymeshlab")
    return Path(spec.origin).parent / "tests" / "sample_meshes"
