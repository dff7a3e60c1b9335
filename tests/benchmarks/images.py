"""Fits to rendered views of known meshes: 1 to 32 views, with silhouettes, depth or normals, beside the visual hull.

python -m tests.benchmarks.images RUNS PAGE PICTURE [--targets NAME,...] [--views COUNT,...] [--page-only]

Every case leaves a file in RUNS, so that a stopped benchmark resumes. Where the code of the engine has changed, remove
the folder.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import meshfit
from meshfit.experiment.storage.run_directory import write_atomically
from meshfit.images.rasteriser import rasterise, render_view
from meshfit.images.sphere_cameras import cameras_around, directions_between, sphere_directions
from meshfit.images.views import View, Views
from meshfit.images.visual_hull import visual_hull
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import frame_of
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.targets import load_target
from tests.benchmarks import images_page

PIXELS = 256
COUNTS = (1, 2, 4, 8, 16, 32)
TARGETS = ("bunny", "mousehead", "cow", "bone")
_HELD_OUT, _SAMPLES = 6, 50_000
_SETTINGS = meshfit.GaussNewtonSettings(verts=5000)
# Those of docs/guide/images.md, with a weight of normals where they are shown.
_FIRST_ORDER: dict[str, Any] = {
    "method": "first-order",
    "steps": 300,
    "samples": 1000,
    "losses": {"silhouette": 1.0, "chamfer": 0.0, "edge": 0.1, "laplacian": 0.05},
    "optimizer": {"name": "adam", "lr": 0.003},
    "views": {"blur": 1.0, "per_step": 4},
}
_FIRST_ORDER_COUNTS = (8,)


class Case(NamedTuple):
    """One fit: a target, a number of views, and what they show."""

    target: str
    count: int
    shows: str
    method: str = "gauss-newton"

    @property
    def file(self) -> str:
        """Name of its result, without a suffix."""
        name = f"{self.target}-{self.count}-{self.shows}"
        return name if self.method == "gauss-newton" else f"{name}-{self.method}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path)
    parser.add_argument("page", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--targets", default=",".join(TARGETS))
    parser.add_argument("--views", default=",".join(map(str, COUNTS)))
    parser.add_argument("--page-only", action="store_true", help="write the page from what has been run")
    options = parser.parse_args()
    options.runs.mkdir(parents=True, exist_ok=True)
    targets, counts = options.targets.split(","), [int(count) for count in options.views.split(",")]
    for case in () if options.page_only else cases(targets, counts):
        path = options.runs / f"{case.file}.json"
        if not path.exists():
            write_atomically(path, json.dumps(_measured(case, options.runs)).encode())
    results = {
        case: json.loads((options.runs / f"{case.file}.json").read_text())
        for case in cases(TARGETS, COUNTS)
        if (options.runs / f"{case.file}.json").exists()
    }
    drawn = images_page.draw(options.runs, options.picture, results, truth, rendered)
    write_atomically(options.page, images_page.text(results, options.picture.name if drawn else None, truth).encode())
    return 0


def cases(targets: Sequence[str], counts: Sequence[int]) -> Iterator[Case]:
    """Yield the cases of some targets, those with few views first."""
    for count in counts:
        for target in targets:
            for shows in images_page.SHOWS:
                yield Case(target, count, shows)
            if count in _FIRST_ORDER_COUNTS:
                yield Case(target, count, "silhouettes", "first-order")
                yield Case(target, count, "normals", "first-order")


def truth(target: str) -> Mesh:
    """Return a named target with a box of diagonal 1."""
    mesh = load_target(target)
    return frame_of(mesh, "box").normalise(mesh)


def rendered(case: Case) -> Views:
    """Return the views of a case."""
    mesh = truth(case.target)
    return Views(
        [
            render_view(mesh, camera, f"{k:02}", depth=case.shows == "depth", normals=case.shows == "normals")
            for k, camera in enumerate(cameras_around(mesh, case.count, PIXELS))
        ]
    )


def _measured(case: Case, runs: Path) -> dict[str, Any]:
    mesh, views = truth(case.target), rendered(case)
    start = time.process_time()
    result = _fitted(case, views)
    seconds = time.process_time() - start
    save_mesh(result, runs / f"{case.file}.ply")
    measures = _compared(result, mesh, case.count) | {"seconds": seconds, "shown": _iou(result, views)}
    if case.shows != "silhouettes" or case.method != "gauss-newton":
        return measures
    start = time.process_time()
    hull = visual_hull(views)
    hull_measures = _compared(hull, mesh, case.count) | {"seconds": time.process_time() - start}
    save_mesh(hull, runs / f"{case.file}-hull.ply")
    return measures | {"hull": hull_measures | {"shown": _iou(hull, views)}}


def _fitted(case: Case, views: Views) -> Mesh:
    if case.method == "gauss-newton":
        return meshfit.fit("auto", views, _SETTINGS, device="cpu").mesh
    normals = {"normals": 0.3} if case.shows == "normals" else {}
    settings = _FIRST_ORDER | {"losses": _FIRST_ORDER["losses"] | normals}
    return meshfit.fit("hull", views, device="cpu", **settings).mesh


def _compared(result: Mesh, mesh: Mesh, count: int) -> dict[str, float]:
    """Return distances in percent of the diagonal, and the IoU of masks of views that were held out."""
    ways = [
        point_distances(other, sample_surface(one, _SAMPLES, np.random.default_rng(0)).points)
        for one, other in ((result, mesh), (mesh, result))
    ]
    cameras = cameras_around(mesh, directions_between(sphere_directions(count), _HELD_OUT), PIXELS)
    held_out = [render_view(mesh, camera, f"{k}") for k, camera in enumerate(cameras)]
    return {
        "rms": 100 * float(np.sqrt(np.mean([np.square(way).mean() for way in ways]))),
        "mean": 100 * float(np.mean([way.mean() for way in ways])),
        "hausdorff": 100 * max(float(way.max()) for way in ways),
        "held_out": _iou(result, held_out),
    }


def _iou(mesh: Mesh, views: Sequence[View]) -> float:
    """Return the mean intersection over union of masks."""
    shares = []
    for view in views:
        mask = rasterise(mesh, view.camera).face >= 0
        shares.append((mask & view.mask).sum() / (mask | view.mask).sum())
    return float(np.mean(shares))


if __name__ == "__main__":
    sys.exit(main())
