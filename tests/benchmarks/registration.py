"""Registration of templates to targets with known correspondence: bent, twisted, posed, turned, noisy, cut, clouds.

python -m tests.benchmarks.registration > docs/background/registration.md
"""

import sys
import time
import warnings
from math import sqrt

import meshfit
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.pieces import crossing_faces
from meshfit.mesh.proximity import point_distances
from tests.benchmarks.registration_pairs import Pair, pairs

_INTRO = """# Registration of known pairs

Made by `make registration-bench`: one seed, one setting, nothing given. Each template has about 8,000 vertices, whose
places on the target are known, as the target is the same shape, meshed otherwise and moved. Numbers are root mean
squares in percent of the diagonal: of the distance of vertices from where they belong, at the start, after
`register: rigid`, and after `register: near-rigid`; then, for the last, of its distance from the target and of the
target's from it. *New crossings* are faces that cross others and did not in the template; seconds are CPU time on one
core.

| pair | start | rigid | near-rigid | result→target | target→result | new crossings | seconds |
| --- | --: | --: | --: | --: | --: | --: | --: |
"""


def main() -> int:
    warnings.simplefilter("ignore")
    sys.stdout.write(_INTRO)
    for make in pairs():
        pair = make()
        rigid = pair.error(_registered(pair, "rigid").verts)
        start = time.process_time()
        fitted = _registered(pair, "near-rigid")
        seconds = time.process_time() - start
        new = int((crossing_faces(fitted)[0] & ~crossing_faces(pair.source)[0]).sum())
        numbers = (pair.error(pair.source.verts), rigid, pair.error(fitted.verts), *_distances(pair, fitted))
        cells = (pair.name, *("–" if number is None else f"{100 * number:.2f}" for number in numbers))
        sys.stdout.write(f"| {' | '.join(cells)} | {new} | {seconds:.1f} |\n")
        sys.stdout.flush()
    return 0


def _registered(pair: Pair, register: str) -> Mesh:
    settings = meshfit.GaussNewtonSettings(connectivity="fixed", levels=0, register=register)
    return meshfit.fit(pair.source, pair.target, settings, align="none", device="cpu").mesh


def _distances(pair: Pair, fitted: Mesh) -> tuple[float | None, float]:
    back = point_distances(fitted, pair.target.verts)
    backward = sqrt(float((back**2).mean())) / pair.diagonal
    if not isinstance(pair.target, Mesh):
        return None, backward
    forward = point_distances(pair.target, fitted.verts)
    return sqrt(float((forward**2).mean())) / pair.diagonal, backward


if __name__ == "__main__":
    sys.exit(main())
