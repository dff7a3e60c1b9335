"""What a result lacks of its target: named, recorded, and marked in tables."""

import numpy as np

from meshfit.measuring.shortfalls import shortfalls
from meshfit.mesh.manifold import TopologyCounts
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron
from meshfit.mesh.topology import Topology
from meshfit.report.tables.formats.latex import to_latex
from meshfit.report.tables.formats.markdown import to_markdown
from meshfit.report.tables.formats.terminal import to_text
from meshfit.report.tables.style import Style
from meshfit.report.tables.table import build_tables, styled
from meshfit.subdivision.refine import subdivide
from tests.runs import result_of
from tests.shapes import patch, torus


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
    assert reach.endswith("% of the target's area is farther than 2% of the target's diagonal from the result")
    assert "1 handle (0 in the result)" in shortfalls(ball, torus())[0]
    # A cap over the hole of a torus is off it.
    ring = torus(24, 16)
    rim = ring.verts[np.abs(np.linalg.norm(ring.verts[:, :2], axis=1) - 1) < 0.01]
    cap = Mesh([[0, 0, 0], *rim], [[0, k + 1, (k + 1) % len(rim) + 1] for k in range(len(rim))])
    *_, off = shortfalls(joined(ring, cap), ring)
    assert off.startswith("off the target: ")


def test_cells_of_results_with_shortfalls_are_marked_and_explained_in_every_format():
    short = result_of(target="cow") | {"shortfalls": ["topology not matched: the target has 1 handle"]}
    tables = build_tables([result_of(), short])
    for text, mark in ((to_text(tables), "†"), (to_markdown(tables), "†"), (to_latex(tables), r"\dag{}")):
        assert text.count(mark) == 2, text
        assert "topology not matched" in " ".join(text.split())
    assert "†" not in to_text(styled(tables, Style(notes="none")))
    assert "†" not in to_text(build_tables([result_of()]))
