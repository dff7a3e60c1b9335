"""Registration tools as programs: read a template and a target, register, write the result, and print CPU seconds.

python registration_peers.py METHOD SOURCE TARGET RESULT [LANDMARKS]

Meshes and points are PLY files. All start from the pose of the template as it is, and find a rigid one first. Lengths
are shares of the target's diagonal. LANDMARKS has rows of source_vertex,x,y,z.
"""

import importlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

_DISTANCE = 0.1
"""Distance beyond which nearest points are no match."""
_RIGID_POINTS = 1000
_CPD = {"alpha": 10.0, "beta": 0.6, "w": 0.02, "max_iterations": 100, "tolerance": 1e-6}
_CPD_POINTS = 500
_MESHMONK_SIZE, _MESHMONK_ITERATIONS = 100.0, 90


class Task(NamedTuple):
    """What a tool gets: arrays of template and target, and landmarks, if any."""

    verts: np.ndarray
    faces: np.ndarray
    target: np.ndarray
    target_faces: np.ndarray
    landmarks: tuple[np.ndarray, np.ndarray] | None


def main() -> None:
    """Run one tool."""
    trimesh: Any = importlib.import_module("trimesh")
    method, source_path, target_path, result_path, *landmark_path = sys.argv[1:]
    source = trimesh.load(source_path, process=False)
    target = trimesh.load(target_path, process=False)
    landmarks = None
    if landmark_path:
        rows = np.loadtxt(landmark_path[0], delimiter=",", skiprows=1)
        landmarks = rows[:, 0].astype(np.int64), rows[:, 1:]
    faces = np.asarray(getattr(target, "faces", np.zeros((0, 3))))
    task = Task(np.array(source.vertices), np.array(source.faces), np.array(target.vertices), faces, landmarks)
    for module in _MODULES[method]:
        importlib.import_module(module)
    start = time.process_time()
    verts = _METHODS[method](task)
    seconds = time.process_time() - start
    trimesh.Trimesh(verts, source.faces, process=False).export(Path(result_path))
    sys.stdout.write(f"CPU seconds: {seconds:.2f}\n")


def _cpd(task: Task) -> np.ndarray:
    """Coherent point drift, as given and after a rigid stage, whichever ends nearer; all vertices go by its kernel."""
    pycpd: Any = importlib.import_module("pycpd")
    generator = np.random.default_rng(0)
    some, others = (points[_some(points, generator)] for points in (task.verts, task.target))
    rigid = pycpd.RigidRegistration(X=others, Y=some, scale=False, w=_CPD["w"])
    rigid.register()
    few = _some(task.verts, generator, _CPD_POINTS)
    others = task.target[_some(task.target, generator, _CPD_POINTS)]
    ends = []
    for start in (task.verts, rigid.transform_point_cloud(task.verts)):
        deformable = pycpd.DeformableRegistration(X=others, Y=start[few], **_CPD)
        deformable.register()
        apart = ((start[:, None] - start[few]) ** 2).sum(axis=2)
        kernel = np.exp(-apart / (2 * _CPD["beta"] ** 2))
        ends.append((float(deformable.sigma2), start + kernel @ deformable.W))
    return np.asarray(min(ends, key=lambda end: end[0])[1])


def _amberg(task: Task) -> np.ndarray:
    trimesh: Any = importlib.import_module("trimesh")
    source, target = _posed(task)
    return np.asarray(trimesh.registration.nricp_amberg(source, target, distance_threshold=_DISTANCE, **_given(task)))


def _sumner(task: Task) -> np.ndarray:
    trimesh: Any = importlib.import_module("trimesh")
    source, target = _posed(task)
    return np.asarray(trimesh.registration.nricp_sumner(source, target, distance_threshold=_DISTANCE, **_given(task)))


def _given(task: Task) -> dict[str, Any]:
    given: dict[str, Any] = {"use_faces": len(task.target_faces) > 0}
    if task.landmarks is not None:
        given["source_landmarks"], given["target_positions"] = task.landmarks
    return given


def _posed(task: Task) -> tuple[Any, Any]:
    """Return the template after rigid ICP, or after the best rigid fit to the landmarks, and the target."""
    trimesh: Any = importlib.import_module("trimesh")
    if task.landmarks is None:
        generator = np.random.default_rng(0)
        some, others = (points[_some(points, generator)] for points in (task.verts, task.target))
        matrix, *_ = trimesh.registration.icp(some, others, max_iterations=50, reflection=False, scale=False)
    else:
        chosen, places = task.landmarks
        matrix, *_ = trimesh.registration.procrustes(task.verts[chosen], places, reflection=False, scale=False)
    verts = trimesh.transform_points(task.verts, matrix)
    source = trimesh.Trimesh(verts, task.faces, process=False)
    if not len(task.target_faces):
        return source, trimesh.PointCloud(task.target)
    return source, trimesh.Trimesh(task.target, task.target_faces, process=False)


def _meshmonk(task: Task) -> np.ndarray:
    """MeshMonk: rigid, then its pyramid, in the size of a face in millimetres, which its defaults are made for."""
    meshmonk: Any = importlib.import_module("meshmonk")
    if not len(task.target_faces):
        sys.exit("meshmonk needs a target with faces")
    meshes = [
        (_MESHMONK_SIZE * verts, faces) for verts, faces in ((task.verts, task.faces), (task.target, task.target_faces))
    ]
    features = [meshmonk.features_from_vertices(*mesh) for mesh in meshes]
    result = meshmonk.pyramid_register(
        floating_features=features[0],
        target_features=features[1],
        floating_faces=task.faces,
        target_faces=task.target_faces,
        floating_flags=np.ones(len(task.verts)),
        target_flags=np.ones(len(task.target)),
        rigid_params={},
        num_iterations=_MESHMONK_ITERATIONS,
    )
    return np.asarray(result.aligned_vertices, dtype=np.float64) / _MESHMONK_SIZE


def _some(points: np.ndarray, generator: np.random.Generator, count: int = _RIGID_POINTS) -> np.ndarray:
    return np.sort(generator.choice(len(points), min(count, len(points)), replace=False))


_METHODS: dict[str, Callable[[Task], np.ndarray]] = {
    "pycpd": _cpd,
    "nricp-amberg": _amberg,
    "nricp-sumner": _sumner,
    "meshmonk": _meshmonk,
}
_MODULES = {
    "pycpd": ["pycpd"],
    "nricp-amberg": ["rtree", "scipy.spatial"],
    "nricp-sumner": ["rtree", "scipy.spatial"],
    "meshmonk": ["meshmonk"],
}

if __name__ == "__main__":
    main()
