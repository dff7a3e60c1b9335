"""The ready entries as a program: read a task, call the library, and write the result and the seconds of the call."""

import importlib
import json
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshfitError
from meshfit.fitting.external.tools import (
    TOOLS,
    AlphaWrapOptions,
    CpdOptions,
    MeshMonkOptions,
    NricpOptions,
    PoissonOptions,
    QuadricOptions,
    SpheresOptions,
    ToolName,
)
from meshfit.mesh.any_target import require_mesh
from meshfit.mesh.geometry import bounding_box_diagonal, face_normals
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import alpha_wrap, decimate, screened_poisson
from meshfit.mesh.point_cloud import PointCloud, oriented_cloud, sampled_areas
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.targets import load_target
from meshfit.settings import Settings, build

_MARGIN = 0.1


class Task(NamedTuple):
    """The meshes and the seed of a call, in the normalised frame."""

    source: Mesh
    target: Mesh | PointCloud
    seed: int

    @property
    def target_mesh(self) -> Mesh:
        """The target of a tool that takes no points."""
        return require_mesh(self.target, "target")


def main() -> None:
    """Run the task in the file that the argument names."""
    path = Path(sys.argv[1])
    content = json.loads(path.read_text(encoding="utf-8"))
    warnings.simplefilter("ignore")  # of libraries, and about meshes that meshfit itself wrote
    name: ToolName = content["tool"]
    options = build(TOOLS[name].options, content["options"])
    target = load_target(Path(content["target"]))
    task = Task(load_mesh(content["source"]), target, int(content["seed"]))
    function = _FUNCTIONS[name]
    try:
        mesh, seconds = function(task, options)
    except MeshfitError as error:
        sys.exit(str(error))
    save_mesh(mesh, content["result"])
    path.with_name("seconds.json").write_text(json.dumps(seconds), encoding="utf-8")


class _Clock:
    """Seconds of a block, which leave out the import of a library."""

    seconds = 0.0

    def __enter__(self) -> "_Clock":
        self._start = time.perf_counter()
        return self

    def __exit__(self, *_: object) -> None:
        self.seconds = time.perf_counter() - self._start


Outcome = tuple[Mesh, float]
"""The mesh that a tool made, and the seconds that it took."""


def _poisson(task: Task, options: Settings) -> Outcome:
    chosen = cast(PoissonOptions, options)
    with _Clock() as clock:
        points, normals = _points_with_normals(task, chosen.samples)
        mesh = screened_poisson(points, normals, chosen.depth, chosen.point_weight)
        mesh = _decimated(mesh, chosen.verts)
    return mesh, clock.seconds


def _points_with_normals(task: Task, count: int) -> tuple[Float64[np.ndarray, "N 3"], Float64[np.ndarray, "N 3"]]:
    if isinstance(task.target, PointCloud):
        cloud = oriented_cloud(task.target)
        assert cloud.normals is not None  # noqa: S101  oriented
        return cloud.verts, cloud.normals
    samples = sample_surface(task.target, count, np.random.default_rng(task.seed))
    return samples.points, face_normals(task.target)[samples.faces]


def _alpha_wrap(task: Task, options: Settings) -> Outcome:
    chosen = cast(AlphaWrapOptions, options)
    size = bounding_box_diagonal(task.target.verts)
    with _Clock() as clock:
        mesh = _decimated(
            alpha_wrap(_mesh_to_wrap(task.target), chosen.alpha * size, chosen.offset * size), chosen.verts
        )
    return mesh, clock.seconds


def _mesh_to_wrap(target: Mesh | PointCloud) -> Mesh:
    return Mesh(target.verts, []) if isinstance(target, PointCloud) else target


def _quadric(task: Task, options: Settings) -> Outcome:
    chosen = cast(QuadricOptions, options)
    with _Clock() as clock:
        mesh = _decimated(task.target_mesh, chosen.verts)
    return mesh, clock.seconds


def _nricp(task: Task, options: Settings) -> Outcome:
    trimesh: Any = importlib.import_module("trimesh")
    chosen = cast(NricpOptions, options)
    register = {"amberg": trimesh.registration.nricp_amberg, "sumner": trimesh.registration.nricp_sumner}
    source, target = (
        trimesh.Trimesh(mesh.verts, mesh.faces, process=False) for mesh in (task.source, task.target_mesh)
    )
    with _Clock() as clock:
        verts = register[chosen.variant](source, target, distance_threshold=chosen.distance)
    return task.source.with_verts(np.asarray(verts)), clock.seconds


def _pycpd(task: Task, options: Settings) -> Outcome:
    pycpd: Any = importlib.import_module("pycpd")
    chosen = cast(CpdOptions, options)
    with _Clock() as clock:
        # The library draws the start of its eigenvectors from numpy's own generator.
        np.random.seed(task.seed % 2**32)  # noqa: NPY002
        points = _some_points(task, chosen.points)
        registration = pycpd.DeformableRegistration(
            X=points,
            Y=task.source.verts,
            alpha=chosen.alpha,
            beta=chosen.beta,
            low_rank=True,
            num_eig=min(chosen.eigenvectors, task.source.num_verts - 2),
            max_iterations=chosen.iterations,
        )
        verts, _ = registration.register()
    return task.source.with_verts(verts), clock.seconds


def _some_points(task: Task, count: int) -> Float64[np.ndarray, "N 3"]:
    generator = np.random.default_rng(task.seed)
    if not isinstance(task.target, PointCloud):
        return sample_surface(task.target, count, generator).points
    areas = sampled_areas(task.target.verts).cumsum()
    at = (np.arange(count) + generator.random(count)) * (areas[-1] / count)
    return np.asarray(task.target.verts[np.unique(np.searchsorted(areas, at).clip(max=task.target.num_verts - 1))])


def _meshmonk(task: Task, options: Settings) -> Outcome:
    meshmonk: Any = importlib.import_module("meshmonk")
    chosen = cast(MeshMonkOptions, options)
    register = {"pyramid": meshmonk.pyramid_register, "nonrigid": meshmonk.nonrigid_register}[chosen.variant]
    with _Clock() as clock:
        features = [meshmonk.features_from_vertices(mesh.verts, mesh.faces) for mesh in (task.source, task.target_mesh)]
        result = register(
            floating_features=features[0],
            target_features=features[1],
            floating_faces=task.source.faces,
            target_faces=task.target_mesh.faces,
            floating_flags=np.ones(task.source.num_verts),
            target_flags=np.ones(task.target.num_verts),
            num_iterations=chosen.iterations,
        )
    return task.source.with_verts(np.asarray(result.aligned_vertices, dtype=np.float64)), clock.seconds


def _reach_for_the_spheres(task: Task, options: Settings) -> Outcome:
    gpytoolbox: Any = importlib.import_module("gpytoolbox")
    chosen = cast(SpheresOptions, options)
    target = task.target_mesh
    both = np.concatenate([task.source.verts, target.verts])
    lows, highs = both.min(axis=0), both.max(axis=0)
    margin = _MARGIN * float((highs - lows).max())
    axes = [np.linspace(low - margin, high + margin, chosen.grid) for low, high in zip(lows, highs, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def signed_distance(queries: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, " N"]:
        distances: Float64[np.ndarray, " N"] = gpytoolbox.signed_distance(queries, target.verts, target.faces)[0]
        return distances

    np.random.seed(task.seed % 2**32)  # noqa: NPY002  the library may draw from numpy's own generator
    with _Clock() as clock:
        source = np.array(task.source.verts), np.array(task.source.faces)
        verts, faces = gpytoolbox.reach_for_the_spheres(points, signed_distance, *source, min_h=chosen.edge)
    return Mesh(np.asarray(verts), np.asarray(faces).astype(np.int64)), clock.seconds


def _decimated(mesh: Mesh, verts: int | None) -> Mesh:
    """Return a mesh decimated to a number of vertices; closed ones have about half as many as faces."""
    if verts is None or mesh.num_verts <= verts:
        return mesh
    return decimate(mesh, round(verts * mesh.num_faces / mesh.num_verts))


_FUNCTIONS: Mapping[ToolName, Callable[[Task, Settings], Outcome]] = MappingProxyType(
    {
        "poisson": _poisson,
        "alpha-wrap": _alpha_wrap,
        "quadric": _quadric,
        "nricp": _nricp,
        "pycpd": _pycpd,
        "meshmonk": _meshmonk,
        "reach-for-the-spheres": _reach_for_the_spheres,
    }
)

if __name__ == "__main__":
    main()
