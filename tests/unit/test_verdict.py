"""The verdict on a result: silent on good fits, and naming what is wrong with others."""

import numpy as np
import pytest

from meshfit.measuring.measure import measure
from meshfit.measuring.settings import MeasureSettings
from meshfit.measuring.verdict import Facts, verdict_on
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import octahedron
from meshfit.subdivision.refine import subdivide
from tests.loops import over

BALL = subdivide(octahedron(), "loop", 3)
ROUGH = subdivide(octahedron(), "loop", 2)


def moved(mesh, scale=1.0, by=(0.0, 0.0, 0.0)):
    return Mesh(mesh.verts * np.asarray(scale) + np.asarray(by), mesh.faces)


def failed(result, source=ROUGH, target=BALL, **changes):
    """Names of the checks that fail, and their texts."""
    distance = measure(result, target, MeasureSettings(samples=500, points=100)).distance
    facts = {"distance": distance, "mean_distances": (1.0, 0.5), "asked_verts": None, "is_placed": False}
    facts |= {"remedy": "", "shortfalls": ()} | changes
    verdict = verdict_on(result, source, target, Facts(**facts))
    record = verdict.to_dict()
    assert record["sound"] is not bool(verdict.findings)
    assert all(check["text"] for check in record["checks"] if not check["passed"])
    return {check.name: check.text for check in verdict.checks if not check.passed}


def test_good_fits_pass_every_check():
    assert failed(ROUGH) == failed(moved(BALL, 0.97), asked_verts=BALL.num_verts) == {}
    plank = moved(BALL, [1.0, 0.01, 0.0001])
    assert failed(plank, target=plank) == {}


@over(
    ("result", "changes", "names"),
    [
        (moved(ROUGH, 1e8), {}, {"size"}),
        (moved(ROUGH, by=(50.0, 0.0, 0.0)), {}, {"end"}),
        (ROUGH, {"source": moved(ROUGH, by=(50.0, 0.0, 0.0))}, {"start"}),
        (ROUGH, {"source": moved(ROUGH, by=(50.0, 0.0, 0.0)), "is_placed": True}, set()),
        (Mesh(ROUGH.verts, ROUGH.faces[:, ::-1]), {}, {"orientation of the result"}),
        (moved(ROUGH, (1.0, 1.0, -1.0)), {}, {"orientation of the result"}),
        (ROUGH, {"source": Mesh(ROUGH.verts, ROUGH.faces[:, ::-1])}, {"orientation of the source"}),
        (ROUGH, {"asked_verts": 10_000}, {"vertices"}),
        (ROUGH, {"mean_distances": (0.1, 0.2)}, {"progress"}),
        (ROUGH, {"shortfalls": ["topology not matched: …", "off the target: …"]}, {"topology", "on target"}),
    ],
)
def test_each_check_names_what_is_wrong(result, changes, names):
    assert set(failed(result, **changes)) == names


def test_a_result_on_a_part_of_the_target_does_not_cover_it():
    pair = np.concatenate([BALL.verts, moved(BALL, by=(3.0, 0.0, 0.0)).verts])
    target = Mesh(pair, np.concatenate([BALL.faces, BALL.faces + BALL.num_verts]))
    texts = failed(ROUGH, target=target)
    assert set(texts) == {"coverage"}
    assert texts["coverage"].startswith("the result covers only a part of the target")


def test_thresholds_are_stated():
    verdict = verdict_on(ROUGH, ROUGH, BALL, Facts(None, (1.0, 0.5), 66, is_placed=False, remedy="", shortfalls=()))
    stated = {check.name: check.threshold for check in verdict.checks}
    assert stated["size"] == pytest.approx(3.0)
    assert stated["progress"] == pytest.approx(1.1)
    assert stated["vertices"] == pytest.approx(0.4)
