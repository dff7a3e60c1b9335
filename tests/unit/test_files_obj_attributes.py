"""Texture coordinates, colours, materials and groups of OBJ files, there and back and as other programs read them."""

import warnings

import numpy as np
import pytest
import trimesh

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.attributes import Attributes, Image, Material, MaterialDefinition
from meshfit.mesh.io.files import encode_mesh, load_mesh, load_polygons, save_mesh
from meshfit.mesh.io.obj import read_obj
from tests.carried import png, require_same, unwrapped_cube
from tests.loops import over

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5 0.25\nvt 1 0\nvt 0 1 0.5\n"


@over("triangles", [False, True])
def test_attributes_come_back_to_the_bit_with_their_images(tmp_path, triangles):
    mesh = unwrapped_cube(triangles=triangles)
    save_mesh(mesh, tmp_path / "cube.obj")
    assert {path.name for path in tmp_path.iterdir()} == {"cube.obj", "cube.mtl", "paint.png"}
    found = load_polygons(tmp_path / "cube.obj")
    require_same(found, mesh)
    assert found.attributes.groups == mesh.attributes.groups
    assert (tmp_path / "paint.png").read_bytes() == png()
    for one, other in zip(found.attributes.materials, mesh.attributes.materials, strict=True):
        assert (one.name, one.color) == (other.name, other.color)
    assert found.attributes.materials[0].texture.content == png()
    assert not load_polygons(tmp_path / "cube.obj", attributes=False).attributes
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    save_mesh(found, tmp_path / "cube.obj")
    assert {path: path.read_bytes() for path in tmp_path.iterdir()}.keys() == before.keys()
    require_same(load_polygons(tmp_path / "cube.obj"), mesh)


def rows_by_place(places, uv):
    """Each pair of a position and texture coordinates, in an order of its own."""
    return np.unique(np.hstack([places, uv]).round(6), axis=0)


def test_trimesh_and_vtk_read_the_same_texture_coordinates_image_and_colours(tmp_path):
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOGeometry import vtkOBJReader

    mesh = unwrapped_cube(triangles=True)
    expected = rows_by_place(mesh.verts[mesh.corners], mesh.attributes.corner["uv"])
    save_mesh(mesh, tmp_path / "cube.obj")
    scene = trimesh.load_scene(str(tmp_path / "cube.obj"), process=False, group_material=False)
    parts = list(scene.geometry.values())
    of_trimesh = [rows_by_place(part.vertices[part.faces].reshape(-1, 3), part.visual.uv[part.faces].reshape(-1, 2))
                  for part in parts]  # fmt: skip
    assert np.array_equal(np.unique(np.concatenate(of_trimesh), axis=0), expected)
    images = [part.visual.material.image for part in parts if part.visual.material.image is not None]
    assert np.asarray(images[0])[0, 0].tolist() == [200, 30, 40]
    reader = vtkOBJReader()
    reader.SetFileName(str(tmp_path / "cube.obj"))
    reader.Update()
    output = reader.GetOutput()
    points = vtk_to_numpy(output.GetPoints().GetData())
    corners = vtk_to_numpy(output.GetPolys().GetConnectivityArray())
    names = [output.GetPointData().GetArrayName(at) for at in range(output.GetPointData().GetNumberOfArrays())]
    uvs = np.stack([vtk_to_numpy(output.GetPointData().GetArray(name)) for name in names if name != "Normals"])
    of_vtk = np.where((uvs >= 0).all(axis=2)[..., None], uvs, 0).max(axis=0)
    assert np.array_equal(rows_by_place(points[corners], of_vtk[corners]), expected)
    coloured = trimesh.load_mesh(str(tmp_path / "cube.obj"), process=False, skip_materials=True, maintain_order=True)
    if coloured.visual.kind == "vertex":
        assert np.allclose(coloured.visual.vertex_colors[:, :3] / 255, mesh.attributes.vertex["color"], atol=1 / 255)


def test_every_way_of_writing_a_corner_gives_its_texture_coordinates():
    uv = [[0.5, 0.25], [1, 0], [0, 1]]
    spellings = ["f 1/1 2/2 3/3", "f 1/1/7 2/2/7 3/3/7", "f -3/-3 -2/-2 -1/-1", "fo 1/1 2/2/9 3/3"]
    for faces in (*spellings, "f 1/1\t2/2 \\\n3/3", "f 1/1/ 2/2/ 3/3/"):
        soup = read_obj((TRIANGLE + faces).encode(), attributes=True)
        assert soup.attributes.corner["uv"].tolist() == uv, faces
    for faces in ("f 1 2 3", "f 1//1 2//1 3//1", "f 1/0 2/0 3/0", "f 1/ 2/ 3/"):
        assert not read_obj((TRIANGLE + faces).encode(), attributes=True).attributes, faces
    mixed = read_obj((TRIANGLE + "f 1/1 2/2 3\nf 1//1 3/3/1 2").encode(), attributes=True)
    assert mixed.attributes.corner["uv"].tolist() == [uv[0], uv[1], [0, 0], [0, 0], uv[2], [0, 0]]
    assert not read_obj(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/2 3/3", attributes=True).attributes


@over(
    ("text", "message"),
    [
        ("f 1/1 2/2 3/4", "line 7: a face with texture coordinates 4, but the file has 3"),
        (
            "f 1/1 2/2 3/3\nf 1/1 \\\n2/-4 3/3",
            "line 8: a face with texture coordinates -4, but the file has 3 of them bef",
        ),
        ("vt 1 x\nf 1/1 2/2 3/3", "line 7: expected numbers, got '1 x'"),
    ],
)
def test_texture_coordinates_that_cannot_be_are_refused_with_their_line(text, message):
    with pytest.raises(MeshError, match=message):
        read_obj((TRIANGLE + text).encode(), attributes=True)
    read_obj((TRIANGLE + text).encode())


@over(
    ("rows", "expected"),
    [
        (["1 0.5 0", "0 0 1", "0.25 0 0"], [[1, 0.5, 0], [0, 0, 1], [0.25, 0, 0]]),
        (["255 128 0", "0 0 1", "1 2 3"], [[255, 128, 0], [0, 0, 1], [1, 2, 3]]),
        (["1 0.5 0 0.5", "0 0 1 1", "0.25 0 0 0"], [[1, 0.5, 0, 0.5], [0, 0, 1, 1], [0.25, 0, 0, 0]]),
        (["1 0.5 0", "", "0 0 0"], [[1, 0.5, 0], [1, 1, 1], [0, 0, 0]]),
        (["-1 0 0", "0 0 1", "0 1 0"], None),  # normals
        (["1", "1", "1"], None),  # weights
    ],
)
def test_colours_follow_the_coordinates_of_vertices(rows, expected):
    text = "".join(f"v {x} {y} 0 {row}\n" for x, y, row in zip((0, 1, 0), (0, 0, 1), rows, strict=True)) + "f 1 2 3"
    soup = read_obj(text.encode(), attributes=True)
    colours = soup.attributes.vertex.get("color")
    assert (None if colours is None else colours.tolist()) == expected
    assert soup.verts.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def test_materials_keep_all_their_lines_and_images_find_a_free_name(tmp_path):
    source, other = tmp_path / "source", tmp_path / "other"
    (source / "maps").mkdir(parents=True)
    other.mkdir()
    (source / "maps" / "skin map.png").write_bytes(png())
    (source / "rough.png").write_bytes(png((1, 2, 3)))
    lines = "Ns 96\nKa 1 1 1\nKd 0.8 0.1 0.1\nillum 2\nTr 0.25\nmap_Kd -s 2 2 1 -o 0.5 0 0 maps\\skin map.png"
    lines += "\nmap_Bump -bm 0.3 C:\\work\\rough.png"
    (source / "looks.mtl").write_text(f"# a comment\nnewmtl skin\n{lines}\n\nnewmtl other\nKd 0 0 0\n")
    (source / "a.obj").write_text(f"mtllib looks.mtl\nusemtl skin\n{TRIANGLE}f 1/1 2/2 3/3\n")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*boundary", MeshfitWarning)
        mesh = load_mesh(source / "a.obj")
    (material,) = mesh.attributes.materials
    assert material.color == (0.8, 0.1, 0.1, 0.75)
    assert material.texture.content == png()
    assert [image.content for image in material.definition.images] == [png(), png((1, 2, 3))]
    (other / "rough.png").write_bytes(b"another image")
    (other / "b.mtl").write_text("newmtl of another file")
    save_mesh(mesh, other / "b.obj")
    assert (other / "rough.png").read_bytes() == b"another image"
    assert (other / "b.mtl").read_text() == "newmtl of another file"
    assert (other / "rough-1.png").read_bytes() == png((1, 2, 3))
    written = (other / "b-1.mtl").read_text()
    expected = lines.replace("maps\\skin map.png", "skin_map.png").replace("C:\\work\\rough.png", "rough-1.png")
    assert written == f"newmtl skin\n{expected}\n"
    assert "mtllib b-1.mtl" in (other / "b.obj").read_text()
    save_mesh(mesh, source / "c.obj")  # beside its own images, which need no copies
    assert "maps/skin map.png" in (source / "c.mtl").read_text()
    assert not list(source.glob("*-1*"))


@over(
    ("library", "found"),
    [
        ("newmtl red\nKd 1 0 0\nmap_Kd ../secret.png\n", "image '../secret.png' is missing"),
        ("newmtl red\nmap_Kd gone.png\nmap_d gone.png\nbump far.png\n", "images 'gone.png', 'far.png' are missing"),
        ("newmtl blue\n", "material 'red' is not defined"),
        (None, "library 'a.mtl' is missing"),
    ],
)
def test_what_is_missing_of_materials_is_said_in_one_line(tmp_path, library, found):
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.png").write_bytes(png())
    if library is not None:
        (tmp_path / "in" / "a.mtl").write_text(library)
    (tmp_path / "in" / "a.obj").write_text(f"mtllib a.mtl\n{TRIANGLE}usemtl red\nf 1/1 2/2 3/3\n")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh = load_mesh(tmp_path / "in" / "a.obj")
    texts = [str(warning.message) for warning in caught if "boundary" not in str(warning.message)]
    assert texts == [f"{tmp_path / 'in' / 'a.obj'}: the look of its materials is incomplete: {found}"]
    assert mesh.attributes.materials[0].texture is None


def test_groups_and_materials_begin_and_end(tmp_path):
    faces = [
        "f 1 3 2",
        "g one two",
        "f 2 3 4",
        "usemtl red",
        "f 3 1 4",
        "o last",
        "usemtl (null)",
        "f 1 2 4",
        "usemtl no",
    ]
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n" + "\n".join(faces)
    attributes = read_obj(text.encode(), attributes=True).attributes
    assert attributes.groups == ("one two", "last")
    assert attributes.face["group"].tolist() == [-1, 0, 0, 1]
    assert attributes.face["material"].tolist() == [-1, -1, 0, -1]
    assert [material.name for material in attributes.materials] == ["red"]
    mesh = load_polygons(_written(tmp_path, text))
    require_same(load_polygons(_written(tmp_path, encode_mesh(mesh, ".obj").decode())), mesh)


def _written(folder, text):
    (folder / "a.obj").write_text(text)
    return folder / "a.obj"


def test_what_an_obj_file_cannot_hold_is_named_in_one_line(tmp_path):
    mesh, count = unwrapped_cube(), 8
    definition = MaterialDefinition(".gltf", {}, (Image("a.png", png()), Image("b.png", b"b")))
    attributes = mesh.attributes
    more = Attributes(
        {
            "color": np.full((count, 4), 128, np.uint8) * [[1, 1, 1, 0]] + np.arange(8)[:, None],
            "quality": np.arange(8.0),
        },
        {**attributes.face, "color": np.zeros((6, 3))},
        attributes.corner,
        (attributes.materials[0], Material("", texture=Image("", png()), definition=definition)),
        attributes.groups,
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        save_mesh(mesh.with_attributes(more), tmp_path / "a.obj")
        save_mesh(mesh, tmp_path / "a.obj.gz")
        save_mesh(mesh, tmp_path / "a.stl")
    assert [str(warning.message).removeprefix(f"{tmp_path}/") for warning in caught] == [
        "a.obj: OBJ cannot hold colours of faces, 'quality', the opacity of vertices, further images of 1 material; "
        "they are left out",
        "a.obj.gz: the looks of its materials would be in files beside it; they are left out",
        "a.stl: STL cannot hold texture coordinates, colours, 2 materials, 3 groups; they are left out",
    ]
    assert {path.name for path in tmp_path.iterdir()} == {"a.obj", "a.mtl", "paint.png", "a.obj.gz", "a.stl"}
