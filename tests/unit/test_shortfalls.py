"""What a result lacks of its target: named, recorded, and marked in tables."""

import csv
import json
from io import StringIO

import numpy as np
import pytest

from meshfit.measuring.shortfalls import FAR_ON_AVERAGE, shortfalls
from meshfit.mesh.geometry import unit_vectors
from meshfit.mesh.manifold import TopologyCounts
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.outer_surface import outer_surface
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.solids import cube, icosahedron
from meshfit.mesh.topology import Topology
from meshfit.report.tables.formats.data import to_csv, to_json
from meshfit.report.tables.formats.latex import to_latex
from meshfit.report.tables.formats.markdown import to_markdown
from meshfit.report.tables.formats.terminal import to_text
from meshfit.report.tables.notes import shortfall_note
from meshfit.report.tables.style import Style
from meshfit.report.tables.table import build_tables, merge_tables, styled
from meshfit.subdivision.refine import subdivide
from tests.runs import result_of
from tests.shapes import patch, torus
from tests.soups import two_balls


def joined(*meshes):
    offsets = np.cumsum([0, *(mesh.num_verts for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return Mesh(np.concatenate([mesh.verts for mesh in meshes]), np.concatenate(faces))


def test_pieces_openings_and_handles_are_counted():
    for mesh, expected in (
        (cube(), (1, 0, 0)),
        (torus(), (1, 0, 1)),
        (patch(), (1, 1, 0)),
        (joined(torus(), patch(), cube()), (3, 1, 1)),
    ):
        assert TopologyCounts.of(Topology.of(mesh)) == expected


def test_a_result_like_its_target_lacks_nothing():
    assert shortfalls(subdivide(torus(), "midpoint"), torus()) == []


def test_missing_handles_and_unreached_parts_are_named_with_their_size():
    ball = subdivide(icosahedron(), "loop", 2)
    (text,) = shortfalls(torus(24, 16), Mesh(torus(24, 16).verts, torus(24, 16).faces[1:]))
    assert text == "topology not matched: the target has 1 opening (0 in the result)"
    far = Mesh(0.5 * ball.verts + [3, 0, 0], ball.faces)
    topology, reach = shortfalls(ball, joined(ball, far))
    assert topology == "topology not matched: the target has 2 pieces (1 in the result)"
    assert reach.startswith("not reached: 20.")
    assert reach.endswith(" % of the target's area is farther than 2 % of the target's diagonal from the result")
    assert "1 handle (0 in the result)" in shortfalls(ball, torus())[0]
    # A cap over the hole of a torus is off it.
    ring = torus(24, 16)
    rim = ring.verts[np.abs(np.linalg.norm(ring.verts[:, :2], axis=1) - 1) < 0.01]
    cap = Mesh([[0, 0, 0], *rim], [[0, k + 1, (k + 1) % len(rim) + 1] for k in range(len(rim))])
    *_, off = shortfalls(joined(ring, cap), ring)
    assert off.startswith("off the target: ")


def off_by(result, target, *far):
    """Return the share of the diagonal, in percent, that the only shortfall names; None without one."""
    texts = shortfalls(result, target, *far)
    assert len(texts) <= 1, texts
    if not texts:
        return None
    assert texts[0].startswith("off the target at one place: by ")
    return float(texts[0].split()[7])


def test_a_thin_bridge_is_named_by_its_distance_and_what_sound_fits_do_is_not():
    ball, size = subdivide(icosahedron(), "loop", 4), 2 * np.sqrt(3)
    ball = ball.with_verts(unit_vectors(ball.verts))
    edges = Topology.of(ball).edges
    edge = np.linalg.norm(ball.verts[edges[:, 0]] - ball.verts[edges[:, 1]], axis=1).mean()

    def pulled(height):  # out of the surface at one vertex, whose faces are 0.1 % of all
        return ball.with_verts(np.concatenate([(1 + height) * ball.verts[:1], ball.verts[1:]]))

    for height in (0.2, 0.4):
        assert off_by(pulled(height), ball) == pytest.approx(100 * height / size, abs=0.05)
        assert (off_by(pulled(height), ball, FAR_ON_AVERAGE) is None) == (height < FAR_ON_AVERAGE * size)
    assert off_by(pulled(0.7 * edge), ball) is None
    cloud = PointCloud(sample_surface(ball, 5000, np.random.default_rng(0)).points)
    assert off_by(pulled(0.4), cloud) == pytest.approx(40 / size, abs=0.2)
    for levels in (1, 2):  # a coarse fit
        coarse = subdivide(icosahedron(), "loop", levels)
        assert not shortfalls(coarse.with_verts(unit_vectors(coarse.verts)), ball)
    # Noise, and what lies beyond the boundary of the target.
    heights = np.random.default_rng(0).normal(0, 0.005 * size, (ball.num_verts, 1))
    noisy = ball.with_verts(ball.verts * (1 + heights))
    assert not shortfalls(ball, noisy)
    upper = ball.verts[ball.faces].mean(axis=1)[:, 2] > -0.99
    assert not [text for text in shortfalls(ball, Mesh(ball.verts, ball.faces[upper])) if "topology" not in text]


def test_holes_that_are_filled_on_purpose_are_no_shortfall():
    ball = subdivide(icosahedron(), "loop", 4)
    ball = ball.with_verts(unit_vectors(ball.verts))
    bowl = Mesh(ball.verts, ball.faces[ball.verts[ball.faces].mean(axis=1)[:, 2] < 0.5])
    lid = ball.with_verts(np.minimum(ball.verts, [2, 2, 0.5]))
    assert [text.split(":")[0] for text in shortfalls(ball, bowl)] == ["topology not matched", "off the target"]
    for result in (lid, ball):  # flat as in the source, or round
        assert not shortfalls(result, bowl, filled=lid)
    fallen = ball.with_verts(ball.verts + 0.3)
    assert [text.split(":")[0] for text in shortfalls(fallen, bowl, filled=lid)] == ["not reached", "off the target"]


HANDLE = "topology not matched: the target has 1 handle (0 in the result)"


def unreached(share):
    return f"not reached: {share} % of the target's area is farther than 2 % of the target's diagonal from the result"


def cell_of(target="cow", scheme="loop", seed=0, *texts):
    return result_of(target, scheme, seed) | {"shortfalls": list(texts), "vertex_error": None}


def squeezed(text):
    return " ".join(text.split())


def test_the_pieces_of_a_soup_are_nothing_to_match():
    ball = subdivide(icosahedron(), "loop", 2)
    soup = Mesh(ball.verts[ball.faces].reshape(-1, 3), np.arange(3 * ball.num_faces).reshape(-1, 3))
    assert shortfalls(ball, soup) == []
    few = joined(*(cube().with_verts(cube().verts + 3 * k) for k in range(13)))
    assert shortfalls(ball, few)[0].startswith("topology not matched: the target has 13 pieces")


def test_cells_of_results_with_shortfalls_are_marked_and_explained_in_every_format():
    tables = build_tables([cell_of("bunny"), cell_of("cow", "loop", 0, HANDLE)])
    for text, mark in ((to_text(tables), "†"), (to_markdown(tables), "†"), (to_latex(tables), r"\dag{}")):
        assert text.count(mark) == 2, text
        assert f"falls short of its target: on the cow, {HANDLE}" in squeezed(text)
    assert "†" not in to_text(styled(tables, Style(notes="none")))
    assert "†" not in to_text(build_tables([result_of()]))


def test_marks_move_no_number_and_stand_beside_other_marks():
    values = {"loop": (0.1, 0.2), "interp-loop": (0.2, 0.1)}
    results = [
        cell_of("cow", scheme, seed, *[HANDLE] * (scheme == "interp-loop")) | {"hausdorff": {"symmetric": value}}
        for scheme, pair in values.items()
        for seed, value in enumerate(pair)
    ]
    tables = build_tables(results)
    first, second = (line for line in to_text(tables).splitlines() if line.startswith(("loop ", "interp-loop ")))
    assert second.endswith(" ≈†")
    assert first.index(")") == second.index(")")
    assert r"\rlap{\,$\approx$\textsuperscript{\dag{}}}" in to_latex(tables)
    assert " ≈† |" in to_markdown(tables)


def test_shortfalls_that_differ_in_numbers_alone_are_stated_once_by_the_worst():
    def note(*results):
        return shortfall_note(merge_tables(build_tables(results))[0])

    runs = [
        cell_of("cow", "loop", seed, *texts) for seed, texts in enumerate(([unreached(2.5)], [unreached(11.0)], []))
    ]
    assert note(*runs) == f"falls short of its target: on the cow, {unreached(11.0)} (worst of 2 of 3 runs)"
    sound = cell_of("cow", "interp-loop")
    assert f"on the cow (loop), {unreached(11.0)} (worst of 2 of 3 runs)" in note(*runs, sound)
    both = [cell_of("cow", scheme, seed, HANDLE) for scheme in ("loop", "interp-loop") for seed in (0, 1)]
    assert note(*both) == f"falls short of its target: on the cow, {HANDLE}"
    assert f"on the cow (loop), {HANDLE} (2 of 3 runs)" in note(*both[:2], cell_of("cow", "loop", 2), sound)
    assert f"{HANDLE}; {unreached(9.0)}; on the cow, " in note(
        cell_of("bunny", "loop", 0, HANDLE, unreached(9.0)), *both
    )
    assert note(sound) == ""


def test_tables_as_data_name_shortfalls_by_cell_and_seed():
    results = [
        cell_of("cow", "loop", 0),
        cell_of("cow", "loop", 1, HANDLE, unreached(3.0)),
        cell_of("cow", "interp-loop"),
    ]
    tables = build_tables(results)
    short, sound = csv.DictReader(StringIO(to_csv(tables)))
    assert (short["shortfalls"], sound["shortfalls"]) == (f"{HANDLE}; {unreached(3.0)}", "")
    cells = json.loads(to_json(tables))["tables"][0]["cells"]
    assert [cell["shortfalls"] for cell in cells] == [{"1": [HANDLE, unreached(3.0)]}, {}]


def test_first_order_fits_miss_parts_farther_off_than_the_ears_that_they_cut_short():
    ball = subdivide(icosahedron(), "loop", 2)
    near = ball.with_verts(0.9 * ball.verts)
    assert len(shortfalls(near, ball)) == 2
    assert shortfalls(near, ball, FAR_ON_AVERAGE) == []
    assert "farther than 10 %" in shortfalls(near, joined(ball, ball.with_verts(ball.verts + 3)), FAR_ON_AVERAGE)[1]


def test_what_is_hidden_is_not_missed():
    balls = two_balls(2)
    skin = outer_surface(balls)
    assert [text.split(":")[0] for text in shortfalls(skin, balls)] == ["topology not matched", "not reached"]
    assert not shortfalls(skin, balls, surface="outer")
    # A lid that is apart from a pot by a gap is no piece to be matched by one skin, but a part to be reached.
    gap = np.array([0.0, 0.0, 0.01])
    upper = balls.verts[balls.faces].mean(axis=1)[:, 2] > 0
    parts = joined(Mesh(balls.verts, balls.faces[~upper]), Mesh(balls.verts + gap, balls.faces[upper]))
    assert not shortfalls(skin, parts, surface="outer")
    reached = [text.split(":")[0] for text in shortfalls(balls.with_verts(0.9 * balls.verts), parts, surface="outer")]
    assert reached == ["not reached", "off the target"]
