"""The verdict on a result: named checks with thresholds, of which each that fails says what is wrong."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from meshfit.measuring.distance import Distance
from meshfit.mesh.geometry import bounding_box_diagonal, signed_volume
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.topology import Topology

COVERAGE, COVERAGE_FROM = 4.0, 0.005
"""Largest ratio of the mean distances from and to the target; those below this share of the diagonal do not count."""
FEWEST_VERTS = 0.4
"""Least share of the vertices that were asked for. Gauss–Newton fits to the bundled targets have all of them, and
sources refined to about a number have at least half of it, as a level multiplies them by 4; fits of thin targets that
had collapsed had 0.15 and 0.26."""
LARGEST, LARGEST_PLACED = 3.0, 10.0
"""Largest size of a result in diagonals of the target; that of templates, of which the target may show a part."""
APART = 2.0
"""Largest distance of the middles of source and target, in diagonals of the target."""
FARTHER, FARTHER_FROM = 1.1, 0.005
"""A result is at most so many times as far from its target as the source was, or nearer than this share of the
diagonal."""
_LEAST_VOLUME = 1e-4
"""Least volume, in cubes of the diagonal, that has a sign worth checking; thin targets have less."""
OF_FIT = "engine"
"""Name of a check that the fit itself, or the overlap of masks, did not pass."""
_SHORTFALLS = {"topology": "topology", "not reached": "reached", "off the target": "on target"}


@dataclass(frozen=True)
class Check:
    """One check of a result.

    Attributes:
        name: such as `coverage`.
        passed: whether nothing is wrong.
        value: the number that is checked; None where it is not one number.
        threshold: the largest value that passes, or for `vertices` and `orientation` the least.
        text: what is wrong, in words; empty if nothing is.
    """

    name: str
    passed: bool
    value: float | None
    threshold: float | None
    text: str


@dataclass(frozen=True)
class Verdict:
    """The checks of a result, in a fixed order."""

    checks: tuple[Check, ...]

    @property
    def findings(self) -> list[str]:
        """What is wrong, in words."""
        return [check.text for check in self.checks if not check.passed]

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as plain data, with `sound` for whether all checks have passed."""
        return {"sound": not self.findings, "checks": [asdict(check) for check in self.checks]}


@dataclass(frozen=True)
class Facts:
    """What a verdict needs to know besides the meshes.

    Attributes:
        distance: distances of the result from the target; None where these do not count.
        mean_distances: those of the source and of the result from the target; None where these do not count.
        asked_verts: number of vertices that were asked for; None if none was.
        is_placed: whether the fit finds the place of the source itself.
        remedy: what to try where the result is farther from the target than the source.
        shortfalls: further findings, as `shortfalls` returns them.
    """

    distance: Distance | None
    mean_distances: tuple[float, float] | None
    asked_verts: int | None
    is_placed: bool
    remedy: str
    shortfalls: Sequence[str]


def verdict_on(result: Mesh, source: Mesh, target: Mesh | PointCloud, facts: Facts) -> Verdict:
    """Check the result of a fit, from a source as it was placed, to a target."""
    checks = [*_size_and_place(result, source, target, is_placed=facts.is_placed)]
    if isinstance(target, Mesh):
        checks += _orientation(result, source, target)
        if facts.distance is not None:
            checks.append(_coverage(facts.distance, bounding_box_diagonal(target.verts)))
    if facts.asked_verts is not None:
        checks.append(_verts(result, facts.asked_verts))
    if facts.mean_distances is not None:
        checks.append(_progress(*facts.mean_distances, bounding_box_diagonal(target.verts), facts.remedy))
    failed = [_name_of(text) for text in facts.shortfalls]
    others = [name for name in _SHORTFALLS.values() if name not in failed]
    checks += [Check(name, passed=True, value=None, threshold=None, text="") for name in others]
    checks += [Check(_name_of(text), passed=False, value=None, threshold=None, text=text) for text in facts.shortfalls]
    return Verdict(tuple(checks))


def _size_and_place(result: Mesh, source: Mesh, target: Mesh | PointCloud, *, is_placed: bool) -> Iterator[Check]:
    diagonal = bounding_box_diagonal(target.verts)
    largest = LARGEST_PLACED if is_placed or isinstance(target, PointCloud) else LARGEST
    size = bounding_box_diagonal(result.verts) / diagonal
    times = f"{size:.2g} times as large as the target; the fit blew up, or never came near"
    yield _at_most("size", size, largest, f"the result is {times}")
    middles = [(mesh.verts.min(axis=0) + mesh.verts.max(axis=0)) / 2 for mesh in (source, result, target)]
    begin, end = (float(np.linalg.norm(middle - middles[2])) / diagonal for middle in middles[:2])
    text = "diagonals of the target away from it; set source.align or source.centre, or normalise"
    if not is_placed:
        yield _at_most("start", begin, APART, f"the source began {begin:.2g} {text}")
    yield _at_most("end", end, APART, f"the result ended {end:.2g} {text}")


def _orientation(result: Mesh, source: Mesh, target: Mesh) -> Iterator[Check]:
    least = _LEAST_VOLUME * bounding_box_diagonal(target.verts) ** 3
    volume = _volume(target, least)
    for name, mesh in (("result", result), ("source", source)):
        own = _volume(mesh, least)
        if volume is None or own is None:
            continue
        share, thing = own / volume, f"the {name} is inside out" if own * volume < 0 else ""
        reason = f"its signed volume is {own:.3g}, that of the target {volume:.3g}"
        yield Check(f"orientation of the {name}", not thing, share, 0.0, f"{thing}: {reason}" if thing else "")


def _volume(mesh: Mesh, least: float) -> float | None:
    """Return the signed volume of a closed surface; None where it is not closed, or encloses next to nothing."""
    if not Topology.of(mesh).is_watertight:
        return None
    volume = signed_volume(mesh)
    return volume if abs(volume) > least else None


def _coverage(distance: Distance, diagonal: float) -> Check:
    back, forth = distance.backward_mean, distance.forward_mean
    ratio = back / max(forth, COVERAGE_FROM * diagonal / COVERAGE)
    text = (
        f"the result covers only a part of the target: mean distance {100 * back / diagonal:.2g} % of the diagonal "
        f"from the target to it, {100 * forth / diagonal:.2g} % from it to the target"
    )
    return _at_most("coverage", ratio, COVERAGE, text)


def _verts(result: Mesh, asked: int) -> Check:
    share = result.num_verts / asked
    passed = share >= FEWEST_VERTS
    text = "" if passed else f"far fewer vertices than asked for: {result.num_verts:,} of {asked:,}"
    return Check("vertices", passed, share, FEWEST_VERTS, text)


def _progress(before: float, after: float, diagonal: float, remedy: str) -> Check:
    text = f"the fit ended farther from the target than it began: mean distance {after:.3g}, at first {before:.3g}"
    ratio = after / max(before, FARTHER_FROM * diagonal / FARTHER)
    return _at_most("progress", ratio, FARTHER, text + remedy)


def _at_most(name: str, value: float, threshold: float, text: str) -> Check:
    passed = bool(value <= threshold)
    return Check(name, passed, float(value) if np.isfinite(value) else None, threshold, "" if passed else text)


def _name_of(text: str) -> str:
    return next((name for start, name in _SHORTFALLS.items() if text.startswith(start)), OF_FIT)
