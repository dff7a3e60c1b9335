"""Fits by the Gauss–Newton engine, set against decimation by MeshLab and against each other."""

from collections.abc import Callable
from functools import partial

from meshfit.fitting.batch import fit_batch
from meshfit.fitting.loop import FitResult
from meshfit.fitting.problem import Problem
from meshfit.mesh.control_mesh import control_mesh_of
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.normalisation import frame_of
from meshfit.mesh.targets import load_target
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.sphere import icosphere
from tests.benchmarks.timing import Benchmark

_VERTS, _MANY = 10_242, 100_000


def _bunny(levels: int = 0) -> Mesh:
    mesh = load_target("bunny")
    return subdivide(frame_of(mesh.verts, "tutorial").normalise(mesh), "loop", levels)


def _near(target: Mesh, verts: int) -> Callable[[], None]:
    """A fit from the target itself with a quarter of the vertices."""
    return partial(_fit, control_mesh_of(target, verts=verts // 4).mesh, target, verts)


def _fit(source: Mesh, target: Mesh, verts: int) -> None:
    (fitted,) = fit_batch([Problem(source, target)], method="gauss-newton", verts=verts, levels=1, device="cpu")
    assert isinstance(fitted, FitResult)
    if not 0.95 * verts < fitted.mesh.num_verts <= verts:
        raise AssertionError(f"{fitted.mesh.num_verts} vertices")


def _small(fit: Callable[[], None], target: Mesh, growth: float, limit: float) -> Benchmark:
    twin = partial(decimate, target, 2 * _VERTS - 4)
    return Benchmark(fit, 3, twin, "MeshLab, quadrics to as many", "growth", growth, limit=limit)


def _near_fit() -> Benchmark:
    target = _bunny()
    return _small(_near(target, _VERTS), target, 7, 4)


def _sphere_fit() -> Benchmark:
    target, ball = _bunny(), icosphere(3)
    ball = ball.with_verts(0.5 * ball.verts + target.verts.mean(axis=0))
    return _small(partial(_fit, ball, target, _VERTS), target, 9, 7)


def _large_fit() -> Benchmark:
    small, large = _bunny(), _bunny(2)
    name = "10,242 vertices, 56,000 faces"
    fit, other = _near(large, _MANY), _near(small, _VERTS)
    return Benchmark(fit, 1, other, name, "growth", 12, limit=45, memory_limit_mb=1500)


FIT_CASES: dict[str, Callable[[], Benchmark]] = {
    "fit, 10,242 verts: from a near source": _near_fit,
    "fit, 10,242 verts: from a sphere": _sphere_fit,
    "fit, 100,000 verts onto 900,000 faces: from a near source": _large_fit,
}
