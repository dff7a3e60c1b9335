# ruff: noqa: E501  one file a line
"""COLLADA files: primitives, holes, nodes and controllers."""

import warnings

import numpy as np
import pytest

from meshfit.errors import MeshError
from meshfit.mesh.io.bridging import with_holes
from meshfit.mesh.io.collada import read_dae
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.triangulation import triangulate
from tests.gltf import CUBE, CUBE_FACES

QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]


def source(points, name="p", stride=3):
    numbers = " ".join(map(repr, np.ravel(points).tolist()))
    accessor = f'<accessor source="#{name}a" count="{len(points)}" stride="{stride}"/>'
    return f'<source id="{name}"><float_array id="{name}a" count="9">{numbers}</float_array><technique_common>{accessor}</technique_common></source>'


INPUT = '<input semantic="VERTEX" source="#v" offset="0"/>'


def geometry(primitives, points=CUBE, name="g"):
    vertices = '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
    return f'<geometry id="{name}"><mesh>{source(points)}{vertices}{primitives}</mesh></geometry>'


def text(rows):
    return " ".join(map(str, np.concatenate([np.ravel(row) for row in rows]).tolist()))


def every(tag, rows):
    return "".join(f"<{tag}>{text([row])}</{tag}>" for row in rows)


def document(geometries, nodes='<node><instance_geometry url="#g"/></node>', more="", scene=True):  # noqa: FBT002
    scenes = f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>'
    instance = '<scene><instance_visual_scene url="#s"/></scene>'
    asset = '<asset><unit meter="0.01" name="centimeter"/><up_axis>Z_UP</up_axis></asset>'
    body = f"{asset}<library_geometries>{geometries}</library_geometries>{more}{scenes + instance if scene else ''}"
    return f'<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">{body}</COLLADA>'.encode()


TRIANGLES = f'<triangles count="12">{INPUT}<p>{text(CUBE_FACES)}</p></triangles>'
CUBES = geometry(TRIANGLES)


def read(content):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        soup = read_dae(content)
    return Mesh(soup.verts, triangulate(soup.verts, soup.corners, soup.sizes)), [str(one.message) for one in caught]


def volume(mesh):
    corners = mesh.verts[mesh.faces]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def area(mesh):
    corners = mesh.verts[mesh.faces]
    return float(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    )


INTERLEAVED = np.stack([CUBE_FACES.ravel(), np.arange(36), np.zeros(36, int)], axis=1)
PRIMITIVES = {
    "triangles": TRIANGLES,
    "in two sets": f'<triangles count="5">{INPUT}<p>{text(CUBE_FACES[:5])}</p></triangles><triangles count="7">{INPUT}<p>{text(CUBE_FACES[5:])}</p></triangles>',
    "with normals and colours": f'<triangles count="12">{INPUT}<input semantic="NORMAL" source="#p" offset="1"/><input semantic="TEXCOORD" source="#p" offset="2" set="0"/><p>{text(INTERLEAVED)}</p></triangles>',
    "with an offset": f'<triangles count="12"><input semantic="NORMAL" source="#p" offset="0"/><input semantic="VERTEX" source="#v" offset="1"/><p>{text(np.roll(INTERLEAVED, 1, axis=1)[:, :2])}</p></triangles>',
    "polylist": f'<polylist count="6">{INPUT}<vcount>{"4 " * 6}</vcount><p>{text(QUADS)}</p></polylist>',
    "mixed polylist": f'<polylist count="8">{INPUT}<vcount>4 4 4 4 3 3 3 3</vcount><p>{text(QUADS[:4])} 0 4 6 0 6 2 1 3 7 1 7 5</p></polylist>',
    "polygons": f'<polygons count="6">{INPUT}{every("p", QUADS)}</polygons>',
    "trifans": f'<trifans count="6">{INPUT}{every("p", QUADS)}</trifans>',
    "tristrips": f'<tristrips count="6">{INPUT}{every("p", [[a, b, d, c] for a, b, c, d in QUADS])}</tristrips>',
    "polylist and polygons": f'<polylist count="3">{INPUT}<vcount>4 4 4</vcount><p>{text(QUADS[:3])}</p></polylist><polygons count="3">{INPUT}{every("p", QUADS[3:])}</polygons>',
}  # fmt: skip


def test_a_cube_of_every_primitive():
    for name, primitives in PRIMITIVES.items():
        mesh, caught = read(document(geometry(primitives)))
        assert (volume(mesh), area(mesh), mesh.num_faces, mesh.num_verts) == (1, 6, 12, 8), name
        assert not caught, name


def node(transforms, inside='<instance_geometry url="#g"/>'):
    return f"<node>{transforms}{inside}</node>"


NODES = {
    "matrix": (node("<matrix>0 2 0 5 1 0 0 6 0 0 1 7 0 0 0 1</matrix>"), 2),
    "mirrored": (node("<scale>-1 1 1</scale>"), 1),
    "plain and mirrored": (node("") + node("<translate>-2 0 0</translate><scale>-1 1 1</scale>"), 2),
    "nested mirrors": (node("<scale>-1 1 1</scale>", node("<scale>1 -2 1</scale>")), 2),
    "rotated": (node('<rotate sid="x">0 0 2 90</rotate><scale>1 2 3</scale>'), 6),
    "a node of the library": (node("<scale>2 2 2</scale>", '<instance_node url="#n"/>') + node("", '<instance_node url="#n"/>'), 9),
    "two in one": (node("", '<instance_geometry url="#g"/>' * 2), 2),
    "a skin": (node("<scale>2 1 1</scale>", '<instance_controller url="#c"/>'), 6),
}  # fmt: skip
MORE = '<library_nodes><node id="n"><instance_geometry url="#g"/></node></library_nodes><library_controllers><controller id="c"><skin source="#g"><bind_shape_matrix>3 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</bind_shape_matrix></skin></controller></library_controllers>'


def test_geometries_stand_where_their_nodes_put_them():
    for name, (nodes, expected) in NODES.items():
        mesh, caught = read(document(CUBES, nodes, MORE))
        assert volume(mesh) == pytest.approx(expected), name
        assert not caught, name


def test_the_transforms_of_a_node_follow_one_another():
    mesh, _ = read(document(CUBES, node("<translate>5 6 7</translate><rotate>0 0 1 90</rotate><scale>2 3 4</scale>")))
    assert np.allclose(mesh.verts[1], [5, 8, 7])
    assert np.allclose(mesh.verts[4], [5, 6, 11])


def test_without_a_scene_each_geometry_is_read_once():
    other = CUBES.replace('id="g"', "").replace('"v"', '"v2"').replace("#v", "#v2")
    assert volume(read(document(CUBES + other, scene=False))[0]) == 2
    mesh, caught = read(document(CUBES + other))
    assert volume(mesh) == 1
    assert caught == ["passed over 1 geometries that the scene does not use"]


def test_lines_are_counted():
    _, caught = read(document(geometry(TRIANGLES + f'<lines count="1">{INPUT}<p>0 1</p></lines>')))
    assert caught == ["passed over 1 sets of lines"]


SQUARE = [[0, 0], [6, 0], [6, 4], [0, 4]]
HOLE, SECOND = [[1, 1], [1, 2], [2, 2], [2, 1]], [[4, 1], [5, 1], [5, 3], [4, 3]]


@pytest.mark.parametrize("order", [1, -1])
def test_holes_of_polygons_stay_open(order):
    points = np.array([[x, y, 0.0] for x, y in SQUARE + HOLE + SECOND])
    loops = [np.arange(4), np.arange(4, 8)[::order], np.arange(8, 12)]
    inside = f"<ph><p>{text([loops[0]])}</p><h>{text([loops[1]])}</h><h>{text([loops[2]])}</h></ph>"
    mesh, _ = read(document(geometry(f'<polygons count="1">{INPUT}{inside}</polygons>', points)))
    assert area(mesh) == pytest.approx(24 - 1 - 2)
    assert volume(Mesh(mesh.verts + [0, 0, 3], mesh.faces)) == pytest.approx(21)  # noqa: RUF005


def test_a_ring_of_many_corners_with_many_holes():
    """Each hole sees the outline, or another hole."""
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    triangle = circle[::20] * 0.05
    loops = [
        circle,
        *(
            triangle + centre
            for centre in np.random.default_rng(1).permutation([[x, y] for x in (-0.4, 0, 0.4) for y in (-0.4, 0, 0.4)])
        ),
    ]
    verts = np.concatenate([np.pad(loop, ((0, 0), (0, 1))) for loop in loops])
    ends = np.cumsum([len(loop) for loop in loops])
    corners = with_holes(verts, [np.arange(end - len(loop), end) for loop, end in zip(loops, ends, strict=True)])
    mesh = Mesh(verts, triangulate(verts, corners, np.array([len(corners)])))
    shoelace = [
        (loop[:, 0] * np.roll(loop[:, 1], -1) - loop[:, 1] * np.roll(loop[:, 0], -1)).sum() / 2 for loop in loops
    ]
    assert area(mesh) == pytest.approx(shoelace[0] - sum(shoelace[1:]))


FAULTS = {
    "cut": (document(CUBES)[:-9], "its XML is damaged or cut short"),
    "root": (b"<COLLADO/>", "expected XML with the root 'COLLADA', got 'COLLADO'"),
    "index": (document(CUBES.replace("<p>0 ", "<p>8 ")), "triangles: index 8, but its positions are numbered 0 to 7"),
    "word": (document(CUBES.replace("<p>0 ", "<p>x ")), "geometry 'g': p: expected integers, got 'x'"),
    "number": (document(CUBES.replace("1.0", "one", 1)), "source 'p': expected numbers, got 'one'"),
    "count": (document(CUBES.replace('count="8"', 'count="9"')), "source 'p' announces 9 points, but has 24 numbers"),
    "corners": (document(CUBES.replace("<p>0 ", "<p>")), "expected three corners for each triangle, got 35"),
    "vcount": (document(geometry(PRIMITIVES["polylist"].replace("4 4", "4 5", 1))), "its vcount names 25 corners, but 24"),
    "file": (document(CUBES, '<node><instance_geometry url="other.dae#g"/></node>'), "expected the id of an element of this file, got 'other.dae#g'"),
    "geometry": (document(CUBES, '<node><instance_geometry url="#h"/></node>'), "instance_geometry refers to geometry '#h', which is not there"),
    "matrix": (document(CUBES, node("<matrix>1 0</matrix>")), "matrix: expected 16 finite numbers, got 2 numbers"),
    "lookat": (document(CUBES, node("<lookat>1 0 0 0 1 0 0 0 1</lookat>")), "the transform 'lookat' is not supported"),
    "cycle": (document(CUBES, '<node id="n"><instance_node url="#n"/></node>'), "nested 1001 deep, or among its own ancestors"),
    "doubling": (document(CUBES, '<node id="n"><instance_node url="#n"/><instance_node url="#n"/></node>'), ""),
    "controller": (document(CUBES, node("", '<instance_controller url="#c"/>'), MORE.replace('skin source="#g"', 'skin source="#c"')), "applies to itself"),
    "no vertex": (document(CUBES.replace("VERTEX", "NORMAL")), "expected one input VERTEX, got 0"),
}  # fmt: skip


def test_the_fault_is_named():
    for name, (content, expected) in FAULTS.items():
        with pytest.raises(MeshError) as caught:
            pytest.fail(f"{name} gives {read(content)}")
        assert expected in str(caught.value), name
        assert "\n" not in str(caught.value)


def test_a_file_by_its_suffix(tmp_path):
    (tmp_path / "a.dae").write_bytes(document(CUBES))
    assert load_mesh(tmp_path / "a.dae").num_faces == 12
