"""Properties, colours and textures of PLY files, there and back and as other programs read them."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from meshfit.errors import MeshfitWarning
from meshfit.mesh.attributes import Attributes, Image, Material
from meshfit.mesh.io.files import encode_mesh, load_mesh, load_polygons, save_mesh
from meshfit.mesh.io.ply import read_ply
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import quad_cube
from tests.carried import png, require_same, unwrapped_cube
from tests.loops import over
from tests.quads import mixed, prism

TYPES = [np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.float32, np.float64]


def carrying(mesh, seed=0, colour=np.uint8):
    """A mesh with data of all types of PLY, its first values the limits of each type."""
    rng, mesh = np.random.default_rng(seed), PolygonMesh.of(mesh)

    def of_every_type(count):
        data = {}
        for dtype in TYPES:
            limits = np.iinfo(dtype) if np.issubdtype(dtype, np.integer) else np.finfo(dtype)
            data[f"of_{dtype.__name__}"] = np.array([limits.min, limits.max, *rng.integers(0, 99, count - 2)], dtype)
        whole = 1 if np.issubdtype(colour, np.floating) else np.iinfo(colour).max
        return data | {"color": (rng.random((count, 4)) * whole).astype(colour)}

    uv = rng.random((len(mesh.corners), 2)).astype(np.float32)
    return mesh.with_attributes(Attributes(of_every_type(mesh.num_verts), of_every_type(mesh.num_faces), {"uv": uv}))


def as_text(content):
    """A binary PLY file as text, by an independent reader of its header."""
    head, body = content.split(b"end_header\n", 1)
    kinds = dict(zip(["char", "uchar", "short", "ushort", "int", "uint", "float", "double"],
                     ["i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"], strict=True))  # fmt: skip
    rows, at, properties, count = [], 0, [], 0

    def take(kind):
        nonlocal at
        value = np.frombuffer(body, "<" + kinds[kind], 1, at)[0]
        at += value.itemsize
        return value

    def flush():
        for _ in range(count):
            words = []
            for words_of in properties:
                if words_of[0] == "list":
                    size = take(words_of[1])
                    words += [str(size), *(str(take(words_of[2])) for _ in range(size))]
                else:
                    words.append(str(take(words_of[0])))
            rows.append(" ".join(words))

    for line in head.decode().splitlines():
        words = line.split()
        if words[0] == "element":
            flush()
            properties, count = [], int(words[2])
        elif words[0] == "property":
            properties.append(words[1:])
    flush()
    return head.replace(b"binary_little_endian", b"ascii") + b"end_header\n" + "\n".join(rows).encode() + b"\n"


@over(
    ("mesh", "colour"),
    [(quad_cube(), np.uint8), (prism(5), np.uint16), (mixed(), np.float32), (prism(200), np.float64)],
)
def test_data_of_every_type_comes_back_to_the_bit_from_binary_and_from_text(tmp_path, mesh, colour):
    mesh = carrying(mesh, colour=colour)
    content = encode_mesh(mesh, ".ply")
    for number, given in enumerate((content, as_text(content))):
        (tmp_path / f"{number}.ply").write_bytes(given)
        found = load_polygons(tmp_path / f"{number}.ply")
        require_same(found, mesh)
        for kind in ("vertex", "face", "corner"):
            for name, values in getattr(mesh.attributes, kind).items():
                assert getattr(found.attributes, kind)[name].dtype == values.dtype, name
        assert encode_mesh(found, ".ply") == content


def test_names_beyond_ascii_are_read(tmp_path):
    material = Material("tëx", texture=Image("tëx.png", png()))
    looks = {"face": {"material": np.zeros(6, int)}, "corner": unwrapped_cube().attributes.corner}
    save_mesh(quad_cube().with_attributes(Attributes(materials=(material,), **looks)), tmp_path / "a.ply")
    assert load_polygons(tmp_path / "a.ply").attributes.materials[0].texture.content == png()
    content = encode_mesh(quad_cube().with_attributes(Attributes(vertex={"temperature": np.arange(8.0)})), ".ply")
    for encoding in ("utf-8", "latin-1"):
        named = content.replace(b"temperature", "température".encode(encoding))
        assert read_ply(named, attributes=True).attributes.vertex["température"].tolist() == list(range(8))


def test_data_of_shuffled_vertices_and_faces_is_shuffled(tmp_path):
    mesh = carrying(mixed())
    rng = np.random.default_rng(1)
    order = rng.permutation(mesh.num_verts)
    place = np.argsort(order)
    shuffled = PolygonMesh(mesh.verts[order], place[mesh.corners], mesh.sizes).with_attributes(
        mesh.attributes.selected(order, np.arange(mesh.num_faces), np.arange(len(mesh.corners)))
    )
    save_mesh(shuffled, tmp_path / "a.ply")
    found = load_polygons(tmp_path / "a.ply")
    require_same(found, shuffled)
    assert np.array_equal(found.attributes.vertex["of_int32"][place], mesh.attributes.vertex["of_int32"])


def rows_by_place(places, uv):
    return np.unique(np.hstack([places, uv]).round(5), axis=0)


@over("triangles", [False, True])
def test_textures_and_seams_come_back_and_other_programs_read_the_same(tmp_path, triangles):
    import pymeshlab

    mesh = unwrapped_cube(triangles=triangles)
    uv = mesh.attributes.corner["uv"].astype(np.float32)
    mesh = mesh.with_attributes(replace(mesh.attributes, corner={"uv": uv}))
    with pytest.warns(MeshfitWarning, match="PLY cannot hold materials beyond their textures, 3 groups; they are left"):
        save_mesh(mesh, tmp_path / "cube.ply")
    assert (tmp_path / "paint.png").read_bytes() == png()
    found = load_polygons(tmp_path / "cube.ply")
    require_same(found.with_attributes(Attributes(found.attributes.vertex, corner=found.attributes.corner)),
                 mesh.with_attributes(Attributes(mesh.attributes.vertex, corner=mesh.attributes.corner)))  # fmt: skip
    expected = np.where(mesh.attributes.face["material"] == 0, 0, -1)
    assert np.array_equal(found.attributes.face["material"], expected)
    assert found.attributes.materials[0].texture.content == png()
    if triangles:
        meshes = pymeshlab.MeshSet()
        meshes.load_new_mesh(str(tmp_path / "cube.ply"))
        other = meshes.current_mesh()
        places = other.vertex_matrix()[other.face_matrix()].reshape(-1, 3)
        rows = rows_by_place(mesh.verts[mesh.corners], mesh.attributes.corner["uv"])
        assert np.array_equal(rows_by_place(places, other.wedge_tex_coord_matrix()), rows)
        plain = trimesh.load_mesh(str(tmp_path / "cube.ply"), process=False)
        assert np.array_equal(rows_by_place(plain.vertices, plain.visual.uv), rows)


def test_trimesh_and_meshio_read_the_same_colours_and_numbers(tmp_path):
    mesh = PolygonMesh.of(carrying(quad_cube()).triangulated())
    names = ["color", "of_uint8", "of_int32", "of_float32", "of_float64"]  # meshio knows no other types
    vertex = {name: mesh.attributes.vertex[name] for name in names}
    mesh = mesh.with_attributes(Attributes(vertex))
    save_mesh(mesh, tmp_path / "a.ply")
    other = trimesh.load_mesh(str(tmp_path / "a.ply"), process=False)
    assert np.array_equal(other.visual.vertex_colors, mesh.attributes.vertex["color"])
    meshio = pytest.importorskip("meshio")
    found = meshio.read(tmp_path / "a.ply")
    for name in names[1:]:
        given = found.point_data[name].astype(vertex[name].dtype)  # it takes uchar for signed
        assert np.array_equal(given, vertex[name]), name
    assert np.array_equal(found.point_data["red"].astype(np.uint8), vertex["color"][:, 0])


HEAD = "ply\nformat ascii 1.0\n{}element vertex 3\nproperty float x\nproperty float y\nproperty float z\n{}" \
    "element face 1\nproperty list uchar int vertex_indices\n{}end_header\n"  # fmt: skip


def ply(comments="", of_verts="", of_faces="", verts=("", "", ""), face="", more=""):
    places = ("0 0 0", "1 0 0", "0 1 0")
    rows = [f"{place} {extra}" for place, extra in zip(places, verts, strict=True)]
    return (HEAD.format(comments, of_verts, of_faces + more) + "\n".join([*rows, f"3 0 1 2 {face}"]) + "\n").encode()


@over("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_of_vertices_are_those_of_corners(tmp_path, names):
    of_verts = "".join(f"property float {name}\n" for name in names)
    (tmp_path / "a.ply").write_bytes(ply(of_verts=of_verts, verts=("0 0", "1 0.5", "0 1")))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*boundary", MeshfitWarning)
        mesh = load_mesh(tmp_path / "a.ply")
    assert mesh.attributes.corner["uv"].tolist() == [[0, 0], [1, 0.5], [0, 1]]
    assert not mesh.attributes.vertex


def test_normals_are_not_read_and_what_else_is_not_is_named_in_one_line():
    of_verts = "property float nx\nproperty float ny\nproperty float nz\nproperty list uchar int rings\n" \
        "property int group\nproperty float confidence\n"  # fmt: skip
    content = ply(of_verts=of_verts, verts=("0 0 1 0 5 0.5", "0 0 1 2 7 7 5 1", "0 0 1 1 3 5 0.25"),
                  of_faces="property list uchar float texcoord\n", face="5 0 0 1 0 1",
                  more="element camera 1\nproperty float view_px\n")  # fmt: skip
    with pytest.warns(MeshfitWarning) as caught:
        soup = read_ply(content + b"3\n", attributes=True)
    assert [str(warning.message) for warning in caught] == [
        "not read: list 'rings' of 'vertex', property 'group' of 'vertex', list 'texcoord' of 'face', element 'camera'"
    ]
    assert soup.attributes.vertex.keys() == {"confidence"}
    assert soup.attributes.vertex["confidence"].tolist() == [0.5, 1, 0.25]
    assert not read_ply(content + b"3\n").attributes


def test_a_texture_that_is_missing_is_said_in_one_line(tmp_path):
    comments = "comment TextureFile gone 1.png\ncomment TextureFile there.png\n"
    (tmp_path / "there.png").write_bytes(png())
    content = ply(comments, of_faces="property uchar texnumber\n", face="1")
    with pytest.warns(MeshfitWarning, match="^image 'gone 1.png' is missing$"):
        attributes = read_ply(content, tmp_path, attributes=True).attributes
    assert attributes.face["material"].tolist() == [1]
    assert [material.name for material in attributes.materials] == ["gone 1", "there"]
    assert attributes.materials[1].texture.content == png()


def test_textures_find_a_free_name_and_what_ply_cannot_hold_is_named(tmp_path):
    mesh = unwrapped_cube()
    materials = (Material("", texture=Image("a b.png", png())), Material("", texture=Image("", png((9, 9, 9)))))
    corner = {"uv": mesh.attributes.corner["uv"], "color": np.repeat(np.arange(18.0).reshape(6, 3) / 18, 4, axis=0)}
    face = {"material": np.array([0, 1, 0, 1, 1, -1])}
    (tmp_path / "a_b.png").write_bytes(b"another image")
    save_mesh(mesh.with_attributes(Attributes({}, face, corner, materials)), tmp_path / "a.ply")
    assert {path.name for path in tmp_path.iterdir()} == {"a.ply", "a_b.png", "a_b-1.png", "a.png"}
    found = load_polygons(tmp_path / "a.ply").attributes
    assert np.array_equal(found.face["material"], face["material"])
    assert np.array_equal(found.face["color"], corner["color"][::4])
    assert [material.texture.content for material in found.materials] == [png(), png((9, 9, 9))]
    vertex = {"joints": np.zeros((8, 4), np.uint8), "weights": np.ones((8, 4)), "a name": np.ones(8), "flow": np.eye(8)}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        save_mesh(mesh.with_attributes(Attributes(vertex, {}, {"color": np.eye(24, 3)})), tmp_path / "b.ply")
        save_mesh(mesh.with_attributes(Attributes({}, face, {}, materials)), tmp_path / "c.ply.gz")
    assert [str(warning.message).removeprefix(f"{tmp_path}/") for warning in caught] == [
        "b.ply: PLY cannot hold colours of corners, skin weights, 'a name', 'flow'; they are left out",
        "c.ply.gz: its textures would be in files beside it; they are left out",
    ]
