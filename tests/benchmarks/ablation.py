"""What each ingredient of the Gauss–Newton engine brings: fits with one of them left out, as a Markdown table.

python -m tests.benchmarks.ablation > docs/background/ablation.md
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import partial
from unittest import mock

import torch

from meshfit.config.experiment import SourceSettings
from meshfit.experiment.source import build_source
from meshfit.fitting.fit import fit
from meshfit.fitting.gauss_newton.sizing import lengths_for
from meshfit.fitting.gauss_newton.sphere_map import SphereMap
from meshfit.measuring.measure import measure
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import frame_of
from meshfit.mesh.targets import load_target
from tests.benchmarks.hidden import hidden_depth
from tests.shapes import table

TARGETS: dict[str, Callable[[], Mesh]] = {
    **{name: partial(load_target, name) for name in ("bunny", "cow", "airplane")},
    "legs": table,
}
SCHEME = "interp-loop"
_HERE = "meshfit.fitting.gauss_newton."


def _unguarded(_connectivity, _start, end, _control=None):
    return end, torch.zeros(len(end), dtype=torch.bool)


def _left_alone(_connectivity, verts):
    return verts, 0


@contextmanager
def patched(**changes: object) -> Iterator[None]:
    """Other values for names in the engine's modules, written `module__name`."""
    with ExitStack() as patches:
        for name, value in changes.items():
            patches.enter_context(mock.patch(_HERE + name.replace("__", ".", 1), value))
        yield


def _even(shape, num_verts, _target, _power=0.0):
    return lengths_for(shape, num_verts, None)


VARIANTS: dict[str, tuple[Callable[[], AbstractContextManager[None]], dict[str, object]]] = {
    "as it is": (nullcontext, {}),
    "steps may cross and fold faces": (lambda: patched(moving_surface__guarded=_unguarded), {}),
    "no untangling": (lambda: patched(moving_surface__untangled=_left_alone), {}),
    "neither": (lambda: patched(moving_surface__guarded=_unguarded, moving_surface__untangled=_left_alone), {}),
    "webs are not under tension": (lambda: patched(webs___TENSION=0.0), {}),
    "no remeshing while the rough shape is found": (
        lambda: patched(stages___STEPS_BETWEEN_REMESHES=10**6, engine__on_sphere=lambda *_: None),
        {},
    ),
    "one try at the rough shape": (nullcontext, {"tries": 1}),
    "no stiffening where steps are refused": (lambda: patched(moving_surface___STIFFER=1.0), {}),
    "one place in each face": (lambda: patched(pairs___PLACES=((1 / 3, 1 / 3, 1 / 3),)), {}),
    "pairs need not face alike": (lambda: patched(pairs___FACING=-2.0, pairs___FACING_BACK=-2.0), {}),
    "one edge length everywhere": (lambda: patched(moving_surface__lengths_for=_even), {}),
    "all faces of the map count alike": (lambda: patched(moving_surface__SphereMap=partial(SphereMap, power=1.0)), {}),
    "fairness stays at 0.1": (nullcontext, {"last_fairness": 0.1}),
    "no last steps": (nullcontext, {"last_steps": 0}),
}
# What the one of both kinds of connectivity does not have.
_NOT_IN = {"all faces of the map count alike": "remeshed"}
_LEVELS_OF_SOURCE = {"remeshed": 3, "fixed": 4}


def row(connectivity: str, target: str, name: str) -> str:
    """One fit as a line of the table."""
    mesh = _framed(TARGETS[target]())
    levels = _LEVELS_OF_SOURCE[connectivity]
    source = build_source(SourceSettings(levels=levels, radius=0.3, project="sphere"), SCHEME)
    context, changes = VARIANTS[name]
    settings = {"method": "gauss-newton", "connectivity": connectivity} | changes
    start = time.process_time()
    with context():
        result = fit(source, mesh, scheme=SCHEME, device="cpu", **settings).mesh
    seconds = time.process_time() - start
    found = measure(result, mesh)
    unsound = found.quality.self_intersecting_faces, found.quality.flipped_faces
    return (
        f"| {connectivity} | {target} | {name} | {found.hausdorff.symmetric:.4f} | {found.distance.mean:.5f} "
        f"| {unsound[0]} | {unsound[1]} | {found.quality.smallest_angle:.1f} | {seconds:.1f} |"
    )


def main() -> None:
    """Print the table."""
    sys.stdout.write(f"{_HEAD}\n")
    for connectivity in ("remeshed", "fixed"):
        for name in VARIANTS:
            if _NOT_IN.get(name) == connectivity:
                continue
            for target in TARGETS:
                sys.stdout.write(f"{row(connectivity, target, name)}\n")
                sys.stdout.flush()
    sys.stdout.write(f"{_HIDDEN}\n")
    for target, make in TARGETS.items():
        sys.stdout.write(f"| {target} | {hidden_depth(_framed(make())):.4f} |\n")


def _framed(mesh: Mesh) -> Mesh:
    return frame_of(mesh.verts, "tutorial").normalise(mesh)


_HEAD = f"""\
# What each ingredient of the Gauss–Newton engine brings

Fits with one ingredient left out: the settings of `accurate` (remeshed) and `accurate-fixed` (fixed) otherwise, scheme
`{SCHEME}`, seed 0, one thread. `legs` is a flat ball on four long legs, near each other in pairs. Distances are in the
tutorial frame, measured with 200,000 samples each way; angles in degrees, time in CPU seconds. `make ablation` makes
this file.

| connectivity | target | without | Hausdorff | mean | self-int. | flipped | least angle | CPU s |
|---|---|---|--:|--:|--:|--:|--:|--:|"""

_HIDDEN = """
## What no sound surface reaches

Where parts of a target run through each other, what is inside is hidden. A surface that agrees with all that is in view
still has a Hausdorff distance of so much:

| target | hidden, at most |
|---|--:|"""

if __name__ == "__main__":
    main()
