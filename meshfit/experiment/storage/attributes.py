"""Attributes of the meshes of a trial: a file beside each PLY, since PLY cannot hold all of them.

It holds every array and the names of groups. Materials and the skin, which a fit does not change, are those of the
source's file.
"""

import io
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.experiment.storage.run_directory import Result
from meshfit.mesh.attributes import JOINTS, MATERIAL, NO_ATTRIBUTES, WEIGHTS, Attributes

if TYPE_CHECKING:
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.polygons import PolygonMesh

_PARTS = ("vertex", "face", "corner")
_GROUPS, _MATERIALS, _SKIN = "groups", "materials", "skin"


def attributes_file(mesh_file: str) -> str:
    """Return the name of the file with the attributes of a mesh: `result.attributes.npz` for `result.ply`."""
    return f"{Path(mesh_file).stem}.attributes.npz"


def encode_attributes(attributes: Attributes) -> bytes:
    """Return the content of the file; the same attributes give the same bytes."""
    arrays = {f"{part}/{name}": rows for part in _PARTS for name, rows in getattr(attributes, part).items()}
    counts = {_MATERIALS: len(attributes.materials), _SKIN: int(attributes.skin is not None)}
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_STORED) as archive:
        for name, rows in {**arrays, **counts, _GROUPS: np.array(attributes.groups, dtype=np.str_)}.items():
            member = io.BytesIO()
            np.save(member, np.asarray(rows), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), member.getvalue())  # without the time
    return content.getvalue()


def with_attributes(mesh: "Mesh | PolygonMesh", path: Path, record: Result) -> "Mesh | PolygonMesh":
    """Return a mesh of a trial with its attributes.

    Args:
        mesh: as it was read from its PLY.
        path: of the PLY.
        record: the trial's `result.json`.

    Warns:
        MeshfitWarning: the materials or the skin, if the source's file has changed or is not there.
    """
    file = path.parent / attributes_file(path.name)
    if not file.is_file():
        return mesh
    try:
        with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        attributes = _decoded(arrays)
        wants_materials, wants_skin = int(arrays[_MATERIALS]) > 0, int(arrays[_SKIN]) > 0
        dressed = mesh.with_attributes(attributes)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, MeshError):
        warnings.warn(f"{file}: damaged; the attributes of {path.name} are left out", MeshfitWarning, stacklevel=2)
        return mesh
    if not (wants_materials or wants_skin):
        return dressed
    looks, fault = _looks(record)
    if fault:
        kept = _without_looks(attributes)
        words = " and ".join(["materials"] * wants_materials + ["skin weights"] * wants_skin)
        warnings.warn(f"left out the {words} of {path.name}: {fault}", MeshfitWarning, stacklevel=2)
        return mesh.with_attributes(kept)
    return mesh.with_attributes(replace(attributes, materials=looks.materials, skin=looks.skin))


def _decoded(arrays: dict[str, Any]) -> Attributes:
    def rows_of(part: str) -> dict[str, Any]:
        return {key.removeprefix(f"{part}/"): rows for key, rows in arrays.items() if key.startswith(f"{part}/")}

    groups = tuple(str(name) for name in arrays[_GROUPS])
    return Attributes(rows_of("vertex"), rows_of("face"), rows_of("corner"), groups=groups)


def _without_looks(attributes: Attributes) -> Attributes:
    """Return the attributes without those that count materials or joints."""
    vertex = {name: rows for name, rows in attributes.vertex.items() if name not in (JOINTS, WEIGHTS)}
    face = {name: rows for name, rows in attributes.face.items() if name != MATERIAL}
    return replace(attributes, vertex=vertex, face=face)


def _looks(record: Result) -> tuple[Attributes, str]:
    """Return the attributes of the source's file, or why there are none."""
    from meshfit.mesh.io.files import open_mesh_file, read_soup
    from meshfit.mesh.targets import file_sha256, target_path

    name, expected = str(record["settings"]["source"]["mesh"]), record.get("inputs", {}).get("source")
    try:
        path = target_path(name)
        if file_sha256(path) != expected:
            return NO_ATTRIBUTES, f"{path} has changed since the fit"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeshfitWarning)  # the trial has reported them
            return read_soup(open_mesh_file(path, "mesh"), attributes=True).attributes, ""
    except MeshError as error:
        return NO_ATTRIBUTES, str(error)
