"""Benchmark cases of loading a mesh file, set against other readers of the same file."""

import tempfile
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from meshfit.mesh.io.files import FORMATS, load_mesh, save_mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.targets import load_target
from meshfit.subdivision.refine import subdivide
from tests.benchmarks.timing import Benchmark

_SUFFIXES = (".obj", ".ply")
_TARGETS = {(".obj", "trimesh"): 1.0, (".obj", "meshio"): 2.0}


def _trimesh(path: str) -> object:
    import trimesh

    return trimesh.load_mesh(path, process=False)


def _meshio(path: str) -> object:
    import meshio

    return meshio.read(path)


def _pymeshlab(path: str) -> object:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(path)
    return meshes.current_mesh().vertex_matrix(), meshes.current_mesh().face_matrix()


def _vtk(path: str) -> object:
    """Single precision."""
    from vtkmodules.vtkIOGeometry import vtkOBJReader
    from vtkmodules.vtkIOPLY import vtkPLYReader

    reader = vtkOBJReader() if path.endswith(".obj") else vtkPLYReader()
    reader.SetFileName(path)
    reader.Update()
    return reader.GetOutput()


_READERS = {"trimesh": _trimesh, "meshio": _meshio, "pymeshlab": _pymeshlab, "vtkmodules": _vtk}


def _loading(suffix: str, package: str) -> Benchmark:
    """Load a closed mesh of 328,000 faces, clean it and check its topology; the others only read the numbers."""
    folder = tempfile.TemporaryDirectory()
    path = Path(folder.name, f"large{suffix}")
    save_mesh(subdivide(decimate(load_target("bunny"), 20_500), "loop", 2), path)

    def ours() -> None:
        if load_mesh(path, attributes=False).num_faces != 328_000:
            raise AssertionError(f"{folder.name}: faces were lost")

    other = partial(_READERS[package], str(path))
    return Benchmark(ours, 5, other, package.removesuffix("modules"), target=_TARGETS.get((suffix, package)))


def _reading(suffix: str) -> Benchmark:
    """Read the numbers of the same file, without cleaning."""
    mesh = subdivide(decimate(load_target("bunny"), 20_500), "loop", 2)
    return Benchmark(partial(FORMATS[suffix].read, FORMATS[suffix].write(mesh)), 5)


LOADING_CASES: dict[str, Callable[[], Benchmark]] = {
    f"load 328,000 faces, {suffix[1:].upper()}: {package.removesuffix('modules')}": partial(_loading, suffix, package)
    for suffix in _SUFFIXES
    for package in _READERS
    if find_spec(package)
} | {f"of which reading, {suffix[1:].upper()}": partial(_reading, suffix) for suffix in _SUFFIXES}
