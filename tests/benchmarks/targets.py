"""Fits to targets of each kind, with three well-known tools beside them: clean, with handles, in pieces, open, noisy.

python -m tests.benchmarks.targets > docs/background/targets.md
"""

import sys
import time
import warnings
from collections.abc import Callable, Mapping
from math import sqrt
from typing import Literal, NamedTuple

import manifold3d
import numpy as np

import meshfit
from meshfit.errors import MeshfitError
from meshfit.mesh.cleaning import clean
from meshfit.mesh.geometry import bounding_box_diagonal, face_normals, unit_vectors, vert_area_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import alpha_wrap, decimate, screened_poisson
from meshfit.mesh.outer_surface import outer_surface
from meshfit.mesh.point_cloud import PointCloud, oriented_cloud
from meshfit.mesh.polygons import PolygonSoup
from meshfit.mesh.proximity import nearest_on_surface
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.targets import load_target
from tests.soups import figure, teapot

_VERTS = 10_242
_SAMPLES = 50_000
_POISSON_POINTS, _POISSON_DEPTH, _POISSON_WEIGHT = 100_000, 8, 4.0
_ALPHA, _OFFSET = 0.01, 0.001
_NOISE = 0.005
_INTRO = f"""# Targets of each kind

Made by `make targets-bench`. Distances are root mean squares in percent of the diagonal of the true shape's bounding
box, from result to shape / from shape to result. *True shape* is the target without its noise, holes and cuts, or what
can be seen of it from outside, *outer surface*. All results have at most {_VERTS:,} vertices; seconds are CPU time on
one core, and crossing faces those of ours.

| target | meshfit fit | seconds | crossing faces | screened Poisson | alpha wrap | quadric decimation |
| --- | --: | --: | --: | --: | --: | --: |
"""


class _Case(NamedTuple):
    name: str
    target: Mesh | PointCloud
    shape: Mesh
    surface: Literal["all", "outer"] = "all"
    source: str = "auto"


def main() -> int:
    warnings.simplefilter("ignore")
    sys.stdout.write(_INTRO)
    for make in (*CASES.values(), *_SOUPS):
        case = make()
        start = time.process_time()
        fitted = meshfit.fit(
            case.source, case.target, method="gauss-newton", verts=_VERTS, surface=case.surface, device="cpu"
        ).mesh
        seconds = time.process_time() - start
        crossing = meshfit.measure(fitted, case.shape, samples=1000, points=1000).quality.self_intersecting_faces
        others = [_outcome(tool, case) for tool in (_poisson, _wrap, _decimation)]
        cells = (case.name, _distances(fitted, case.shape), f"{seconds:.1f}", str(crossing), *others)
        sys.stdout.write(f"| {' | '.join(cells)} |\n")
        sys.stdout.flush()
    return 0


def _distances(result: Mesh, shape: Mesh) -> str:
    ways = []
    for origin, surface in ((result, shape), (shape, result)):
        points = sample_surface(origin, _SAMPLES, np.random.default_rng(0)).points
        ways.append(sqrt(float((nearest_on_surface(surface, points).distances ** 2).mean())))
    return " / ".join(f"{100 * way / bounding_box_diagonal(shape.verts):.3f}" for way in ways)


def _outcome(tool: Callable[[Mesh | PointCloud], Mesh], case: _Case) -> str:
    try:
        return _distances(tool(case.target), case.shape)
    except MeshfitError:
        return "–"


def _poisson(target: Mesh | PointCloud) -> Mesh:
    if isinstance(target, PointCloud):
        cloud = oriented_cloud(target)
        assert cloud.normals is not None
        points, normals = cloud.verts, cloud.normals
    else:
        samples = sample_surface(target, _POISSON_POINTS, np.random.default_rng(0))
        points, normals = samples.points, face_normals(target)[samples.faces]
    return decimate(screened_poisson(points, normals, _POISSON_DEPTH, _POISSON_WEIGHT), 2 * _VERTS)


def _wrap(target: Mesh | PointCloud) -> Mesh:
    size = bounding_box_diagonal(target.verts)
    mesh = Mesh(target.verts, []) if isinstance(target, PointCloud) else target
    return decimate(alpha_wrap(mesh, _ALPHA * size, _OFFSET * size), 2 * _VERTS)


def _decimation(target: Mesh | PointCloud) -> Mesh:
    if isinstance(target, PointCloud):
        raise MeshfitError("a cloud has no faces")
    return decimate(target, min(2 * _VERTS, target.num_faces))


def _handles() -> _Case:
    box = manifold3d.Manifold.cube((2, 2, 1), center=True)
    holes = [
        manifold3d.Manifold.cylinder(4, 0.3, center=True, circular_segments=64).translate((x, x, 0))
        for x in (-0.45, 0.45)
    ]
    rounded = (box - holes[0] - holes[1]).refine_to_length(0.05)
    return _same("box with two holes", _of(rounded))


def _pieces() -> _Case:
    ball = meshfit.icosphere(5)
    return _same("two balls apart", _joined(ball, ball.with_verts(0.5 * ball.verts + np.array([2.0, 0.3, 0.0]))))


def _shells() -> _Case:
    ball = meshfit.icosphere(5)
    inner = Mesh(0.6 * ball.verts, ball.faces[:, ::-1])
    return _same("ball with a cavity", _joined(ball, inner))


def _crossing() -> _Case:
    ball = meshfit.icosphere(5)
    return _same("two balls that cross", _joined(ball, ball.with_verts(ball.verts + np.array([1.1, 0.2, 0.0]))))


def _figure() -> _Case:
    return _same("40 ellipsoids that cross", figure(40, 4))


def _skin_of_figure() -> _Case:
    return _outer("40 ellipsoids that cross", figure(40, 4))


def _skin_of_teapot() -> _Case:
    return _outer("teapot of open parts", teapot(3))


def _skin_of_cow() -> _Case:
    return _outer("cow", load_target("cow"))


def _outer(name: str, mesh: Mesh) -> _Case:
    return _Case(f"{name}, outer surface", mesh, outer_surface(mesh), "outer")


def _noisy() -> _Case:
    bunny = load_target("bunny")
    sigma = _NOISE * bounding_box_diagonal(bunny.verts)
    heights = np.random.default_rng(0).normal(0, sigma, (bunny.num_verts, 1))
    return _Case(
        "bunny, noise of 0.5 %", bunny.with_verts(bunny.verts + heights * unit_vectors(vert_area_vectors(bunny))), bunny
    )


def _holes() -> _Case:
    bunny = load_target("bunny")
    middle = bunny.verts[bunny.faces].mean(axis=1)
    centres = middle[np.random.default_rng(0).integers(len(middle), size=20)]
    distance = np.linalg.norm(middle[:, None] - centres, axis=2).min(axis=1)
    return _Case("bunny, 18 % of faces cut out", _part(bunny, distance > np.quantile(distance, 0.18)), bunny)


def _filled() -> _Case:
    holes = _holes()
    return holes._replace(name="the same, its holes filled (`source.mesh: closed`)", source="closed")


def _half() -> _Case:
    bunny = load_target("bunny")
    middle = bunny.verts[bunny.faces].mean(axis=1)[:, 2]
    half = _part(bunny, middle > middle.mean())
    return _same("front half of the bunny", half)


def _cloud() -> _Case:
    bunny = load_target("bunny")
    generator = np.random.default_rng(0)
    samples = sample_surface(bunny, 20_000, generator)
    sigma = _NOISE * bounding_box_diagonal(bunny.verts)
    heights = generator.normal(0, sigma, (len(samples.points), 1))
    points = samples.points + heights * face_normals(bunny)[samples.faces]
    return _Case("20,000 points of the bunny, noise of 0.5 %", PointCloud(points), bunny)


def _stray() -> _Case:
    cloud = _cloud()
    low, high = cloud.shape.verts.min(axis=0), cloud.shape.verts.max(axis=0)
    stray = np.random.default_rng(1).uniform(low, high, (cloud.target.num_verts // 10, 3))
    points = np.concatenate([cloud.target.verts, stray])
    return _Case("the same with 2,000 stray points in its box", PointCloud(points), cloud.shape)


def _spikes() -> _Case:
    noisy, generator = _noisy(), np.random.default_rng(1)
    chosen = generator.choice(noisy.shape.num_verts, 140, replace=False)
    heights = np.zeros((noisy.shape.num_verts, 1))
    heights[chosen] = 0.05 * bounding_box_diagonal(noisy.shape.verts) * generator.uniform(-1, 1, (140, 1))
    normals = unit_vectors(vert_area_vectors(noisy.shape))
    return _Case(
        "bunny, noise of 0.5 % and 140 spikes of up to 5 %",
        noisy.target.with_verts(noisy.target.verts + heights * normals),
        noisy.shape,
    )


def _clean() -> _Case:
    return _same("bunny", load_target("bunny"))


def _same(name: str, mesh: Mesh) -> _Case:
    return _Case(name, mesh, mesh)


def _of(solid: manifold3d.Manifold) -> Mesh:
    mesh = solid.to_mesh()
    return _cleaned(Mesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts)))


def _joined(first: Mesh, second: Mesh) -> Mesh:
    return Mesh(
        np.concatenate([first.verts, second.verts]), np.concatenate([first.faces, second.faces + first.num_verts])
    )


def _part(mesh: Mesh, kept: np.ndarray) -> Mesh:
    return _cleaned(Mesh(mesh.verts, mesh.faces[kept]))


def _cleaned(mesh: Mesh) -> Mesh:
    return clean(PolygonSoup.of_triangles(mesh.verts, mesh.faces), "target", triangles=True)[0].triangulated()


CASES: Mapping[str, Callable[[], _Case]] = {
    "handles": _handles,
    "pieces": _pieces,
    "shells": _shells,
    "crossing": _crossing,
    "noisy": _noisy,
    "holes": _holes,
    "filled": _filled,
    "half": _half,
    "cloud": _cloud,
    "stray": _stray,
    "spikes": _spikes,
    "animal": _clean,
}
"""Targets by the name of their kind, in the order of the table."""
_SOUPS = (_figure, _skin_of_figure, _skin_of_teapot, _skin_of_cow)


if __name__ == "__main__":
    sys.exit(main())
