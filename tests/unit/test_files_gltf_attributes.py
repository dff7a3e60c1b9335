"""What meshes carry in glTF files: texture coordinates, colours, custom data, materials, groups and skins."""

import base64
import io
import json
import pickle
import re
import struct
import warnings
from contextlib import contextmanager

import numpy as np
import pytest

from meshfit.errors import MeshfitWarning
from meshfit.mesh.attributes import Attributes, Image, Material, MaterialDefinition, Skin
from meshfit.mesh.io.files import encode_mesh, load_mesh, save_mesh
from meshfit.mesh.io.gltf import read_gltf
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import icosahedron, quad_cube
from tests.gltf import CUBE, CUBE_FACES, GltfFile
from tests.loops import over

RNG = np.random.default_rng(5)


def picture(kind="PNG", size=8, shift=0):
    """Return the bytes of a checked image."""
    from PIL import Image as Pillow

    checks = (np.add.outer(np.arange(size), np.arange(size)) % 2 * 200 + shift).astype("u1")
    content = io.BytesIO()
    Pillow.fromarray(checks).convert("RGB").save(content, kind)
    return content.getvalue()


PNG, OTHER_PNG, JPEG = picture(), picture(shift=40), picture("JPEG")


TGA = Image("a.tga", b"-")


def unrolled():
    """A cube of six charts, a square for each face, and the number of vertices that it needs."""
    cube = quad_cube()
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    charts = [(square + np.array([face % 3, face // 3])) / [3, 2] for face in range(6)]
    uv = np.concatenate(charts).astype("f4").astype(float)
    count = len({(vert, *row) for vert, row in zip(cube.corners.tolist(), uv.tolist(), strict=True)})
    return PolygonMesh(cube.verts, cube.corners, cube.sizes, Attributes(corner={"uv": uv})), count


def there_and_back(mesh, tmp_path, name="a.glb"):
    save_mesh(mesh, tmp_path / name)
    return load_mesh(tmp_path / name)


def placed_rows(mesh, name):
    """Return the data of each corner beside its place and the middle of its face, in an order that does not count."""
    corners = mesh.verts[mesh.faces].reshape(-1, 3)
    middles = np.repeat(mesh.verts[mesh.faces].mean(axis=1), 3, axis=0)
    given = mesh.attributes
    if name in given.face:
        values = np.repeat(given.face[name], 3, axis=0)
    else:
        values = given.corner[name] if name in given.corner else given.vertex[name][mesh.faces.ravel()]
    rows = np.column_stack([np.round(middles, 4), np.round(corners, 4)]) + 0.0
    order = np.lexsort(rows.T)
    return rows[order], values[order]


def same_rows(one, other, name, tolerance=0.0):
    (places, values), (other_places, other_values) = placed_rows(one, name), placed_rows(other, name)
    return (
        np.allclose(places, other_places, atol=2e-4)
        and values.shape == other_values.shape
        and np.abs(values.astype(float) - other_values).max(initial=0) <= tolerance
    )


@contextmanager
def heard():
    """Give the texts of the warnings within."""
    texts = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield texts
    texts += [str(warning.message) for warning in caught if issubclass(warning.category, MeshfitWarning)]


def corner_texture_coordinates(file_content):
    """Return what the standard says of the first primitive of a GLB: texture coordinates of its indices."""
    size = struct.unpack_from("<I", file_content, 12)[0]
    document, binary = json.loads(file_content[20 : 20 + size]), file_content[28 + size :]

    def numbers(index, dtype, columns):
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        return np.frombuffer(binary, dtype, accessor["count"] * columns, view.get("byteOffset", 0)).reshape(-1, columns)

    primitive = document["meshes"][0]["primitives"][0]
    return numbers(primitive["attributes"]["TEXCOORD_0"], "<f4", 2)[numbers(primitive["indices"], "<u2", 1).ravel()]


# There and back


def test_texture_coordinates_and_their_seams_there_and_back(tmp_path):
    cube, count = unrolled()
    mesh = cube.triangulated()
    found = there_and_back(mesh, tmp_path)
    assert np.array_equal(found.faces, mesh.faces)
    assert np.array_equal(found.verts, mesh.verts.astype("f4"))
    assert np.allclose(found.attributes.corner["uv"], mesh.attributes.corner["uv"], atol=1e-7)
    content = (tmp_path / "a.glb").read_bytes()
    assert len(read_gltf(content, attributes=True).verts) == count
    assert np.allclose(corner_texture_coordinates(content), mesh.attributes.corner["uv"] * [1, -1] + [0, 1], atol=1e-7)
    assert encode_mesh(found, ".glb") == content
    assert encode_mesh(found, ".gltf") == encode_mesh(load_mesh(tmp_path / "a.glb"), ".gltf")


def test_only_vertices_whose_corners_differ_are_repeated():
    mesh = icosahedron()
    uv = mesh.verts[mesh.faces.ravel(), :2].copy()
    assert len(read_gltf(encode_mesh(mesh.with_attributes(Attributes(corner={"uv": uv})), ".glb")).verts) == 12
    uv[mesh.faces.ravel() == 3] = RNG.random((5, 2))
    uv[0] += 0.0
    soup = read_gltf(encode_mesh(mesh.with_attributes(Attributes(corner={"uv": uv})), ".glb"))
    assert len(soup.verts) == 12 + 4
    assert np.array_equal(soup.verts[:12], mesh.verts.astype("f4"))


def carrying(mesh):
    """Return a mesh with data of every kind that a glTF file holds."""
    rng = np.random.default_rng(1)
    material = rng.integers(-1, 2, mesh.num_faces)
    return mesh.with_attributes(
        Attributes(
            vertex={
                "color": rng.integers(0, 256, (mesh.num_verts, 3)).astype("u1"),
                "heat": rng.random(mesh.num_verts).astype("f4"),
                "kind": rng.integers(-5, 5, (mesh.num_verts, 3)).astype("i2"),
                "_odd": rng.random(mesh.num_verts) < 0.5,
            },
            face={"material": material, "group": (mesh.verts[mesh.faces].mean(axis=1)[:, 2] > 0).astype(int)},
            corner={"uv": rng.random((3 * mesh.num_faces, 2)), "uv1": rng.random((3 * mesh.num_faces, 2))},
            materials=(
                Material("skin", (1.0, 0.5, 0.25, 1.0)),
                Material("glass", (0.0, 0.0, 1.0, 0.5), Image("a.png", PNG)),
            ),
            groups=("lower half", "upper half"),
        )
    )


@over("suffix", [".glb", ".gltf"])
def test_all_kinds_of_data_there_and_back(tmp_path, suffix):
    mesh = carrying(icosahedron())
    with heard() as texts:
        found = there_and_back(mesh, tmp_path, f"a{suffix}")
    assert not texts
    carried = found.attributes
    assert found.num_verts == mesh.num_verts
    for name in ("color", "heat", "kind", "_odd", "uv", "uv1", "material", "group"):
        assert same_rows(mesh, found, name, tolerance=1e-7), name
    assert carried.vertex["color"].dtype == np.uint8
    assert carried.vertex["heat"].dtype == np.float32
    assert carried.vertex["kind"].dtype == np.int16
    assert carried.groups == mesh.attributes.groups
    glass = carried.materials[1]
    assert (glass.name, glass.color, glass.texture.content) == ("glass", (0, 0, 1, 0.5), PNG)
    assert glass.definition.content["material"]["alphaMode"] == "BLEND"
    assert pickle.loads(pickle.dumps(carried)).vertex["kind"].tolist() == carried.vertex["kind"].tolist()


@over("dtype", ["u1", "u2", "f4", "f8"])
@over("columns", [3, 4])
@over("place", ["vertex", "face", "corner"])
def test_colours_keep_their_type(tmp_path, dtype, columns, place):
    mesh = icosahedron()
    count = {"vertex": 12, "face": 20, "corner": 60}[place]
    color = np.random.default_rng(0).random((count, columns))
    color = color.astype(dtype) if dtype[0] == "f" else (color * np.iinfo(dtype).max).astype(dtype)
    mesh = mesh.with_attributes(Attributes(**{place: {"color": color}}))
    found = there_and_back(mesh, tmp_path)
    assert found.num_verts == 12
    assert same_rows(mesh, found, "color", tolerance=1e-7)
    rows = found.attributes.vertex if place == "vertex" else found.attributes.corner
    assert rows["color"].dtype == ("f4" if dtype == "f8" else dtype)


def test_what_the_format_cannot_hold_is_named_in_one_line(tmp_path):
    mesh = icosahedron().with_attributes(
        Attributes(
            vertex={"frame": np.zeros((12, 9)), "joints": np.zeros((12, 4), "u1"), "id": np.arange(12) + 2**40 + 1},
            face={"quality": np.arange(20), "material": np.zeros(20, int)},
            materials=(Material("a", definition=MaterialDefinition(".obj", "", (TGA, TGA)), texture=TGA),),
        )
    )
    with heard() as texts:
        found = there_and_back(mesh, tmp_path)
    assert texts == [
        f"{tmp_path / 'a.glb'}: GLB cannot hold face data 'quality', 'frame' (float64 in rows of 9), 'id' (int64), "
        "joints and weights without a skin, further images of 1 material, the texture 'a.tga', "
        "which is neither PNG nor JPEG; they are left out"
    ]
    assert not found.attributes.vertex
    assert found.attributes.materials[0].texture is None


# Materials


def textured_file(**material):
    """A cube with texture coordinates, a material that refers to three textures, and two images."""
    file = GltfFile.of_cube()
    uv = np.random.default_rng(2).random((8, 2)).astype("<f4")
    primitive = file.json["meshes"][0]["primitives"][0]
    primitive["attributes"]["TEXCOORD_0"] = file.accessor(uv)
    primitive["material"] = 1
    file.json["images"] = [
        {"uri": "data:image/jpeg;base64," + base64.b64encode(JPEG).decode()},
        {"bufferView": file.view(PNG), "mimeType": "image/png", "name": "paint"},
        {"bufferView": file.view(OTHER_PNG), "mimeType": "image/png", "extras": {"by": "hand"}},
    ]
    file.json["samplers"] = [{}, {"magFilter": 9728, "wrapS": 33071}]
    file.json["textures"] = [{"source": 0}, {"source": 1, "sampler": 1, "name": "t"}, {"source": 2, "sampler": 1}]
    file.json["materials"] = [
        {"name": "not used"},
        {
            "name": "paint",
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.5, 0.25, 1, 1],
                "baseColorTexture": {
                    "index": 1,
                    "extensions": {"KHR_texture_transform": {"offset": [0.5, 0], "scale": [2, 2]}},
                },
                "metallicFactor": 0.25,
            },
            "normalTexture": {"index": 2, "scale": 0.5},
            "emissiveTexture": {"index": 0, "texCoord": 0},
            "emissiveFactor": [1, 0, 0],
            "extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 1, "clearcoatTexture": {"index": 2}}},
            "extras": {"anyTexture": {"index": 99}},
            "doubleSided": True,
        }
        | material,
    ]
    return file, uv


def test_a_material_keeps_all_that_its_file_says_of_it(tmp_path):
    file, uv = textured_file()
    mesh = load_mesh(file.write(tmp_path, "given.glb"))
    material = mesh.attributes.materials[0]
    assert len(mesh.attributes.materials) == 1
    assert (material.name, material.color) == ("paint", (0.5, 0.25, 1, 1))
    assert (material.texture.name, material.texture.content) == ("paint.png", PNG)
    turned = uv[CUBE_FACES.ravel()].astype(float) * [1, -1] + [0, 1]
    assert np.array_equal(mesh.attributes.corner["uv"], turned)
    found = there_and_back(mesh, tmp_path)
    given, kept = (it.attributes.materials[0].definition for it in (mesh, found))
    assert kept.content["material"] == given.content["material"]
    assert kept.content["material"]["extras"] == {"anyTexture": {"index": 99}}
    assert [image.content for image in kept.images] == [image.content for image in given.images]
    assert {image.content for image in kept.images} == {PNG, OTHER_PNG, JPEG}
    assert kept.content["textures"] == given.content["textures"]
    assert given.content["textures"][0] == {"source": 0, "sampler": {"magFilter": 9728, "wrapS": 33071}, "name": "t"}
    assert kept.content["images"][1]["extras"] == {"by": "hand"}
    assert np.array_equal(found.attributes.corner["uv"], turned)
    written = json.loads(encode_mesh(found, ".gltf"))
    assert written["extensionsUsed"] == ["KHR_materials_clearcoat", "KHR_texture_transform"]
    assert len(written["images"]) == 3
    assert len(written["samplers"]) == 1


def test_a_changed_colour_and_texture_are_written():
    file, _ = textured_file()
    mesh = read_gltf(file.glb(), attributes=True)
    old = mesh.attributes.materials[0]
    changed = Material("new", (0.0, 1.0, 0.0, 1.0), Image("b.png", OTHER_PNG), old.definition)
    attributes = Attributes(mesh.attributes.vertex, mesh.attributes.face, materials=(changed,))
    soup = read_gltf(encode_mesh(Mesh(mesh.verts, mesh.corners.reshape(-1, 3), attributes), ".glb"), attributes=True)
    found = soup.attributes.materials[0]
    assert (found.name, found.color, found.texture.content) == ("new", (0, 1, 0, 1), OTHER_PNG)
    assert found.definition.content["material"]["normalTexture"]["scale"] == 0.5


def test_a_required_extension_stays_required():
    file, _ = textured_file()
    file.json["textures"][0] = {"extensions": {"KHR_texture_basisu": {"source": 0}}}
    file.json["extensionsUsed"] = ["KHR_texture_basisu", "KHR_materials_clearcoat", "KHR_texture_transform"]
    file.json["extensionsRequired"] = ["KHR_texture_basisu"]
    soup = read_gltf(file.glb(), attributes=True)
    written = json.loads(encode_mesh(Mesh(soup.verts, soup.corners.reshape(-1, 3), soup.attributes), ".gltf"))
    assert written["extensionsRequired"] == ["KHR_texture_basisu"]
    assert [texture for texture in written["textures"] if "source" not in texture] == [
        {"extensions": {"KHR_texture_basisu": {"source": 2}}}
    ]


def test_images_beside_the_file(tmp_path):
    file, _ = textured_file()
    file.json["images"][1] = {"uri": "maps/my%20paint.png"}
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "my paint.png").write_bytes(PNG)
    texture = load_mesh(file.write(tmp_path, "a.gltf")).attributes.materials[0].texture
    assert (texture.name, texture.content) == ("my paint.png", PNG)
    (tmp_path / "maps" / "my paint.png").unlink()
    assert load_mesh(tmp_path / "a.gltf", attributes=False).num_faces == 12  # its images are not looked for
    with heard() as texts:
        material = load_mesh(tmp_path / "a.gltf").attributes.materials[0]
    assert texts == [
        f"{tmp_path / 'a.gltf'}: left out damaged attributes: images[1]: its file 'maps/my paint.png' is missing in "
        f"{tmp_path}"
    ]
    assert material.texture is None
    assert material.color == (0.5, 0.25, 1, 1)


# Data of other files


@over("form", ["float", "u1", "u2", "sparse", "interleaved", "integers"])
def test_texture_coordinates_in_every_form(form):
    whole = np.random.default_rng(3).integers(0, 256, (8, 2))
    file = GltfFile.of_cube()
    attributes = file.json["meshes"][0]["primitives"][0]["attributes"]
    expected = whole / 255.0
    if form == "float":
        expected = expected.astype("<f4").astype(float)
        accessor = file.accessor(expected.astype("<f4"))
    elif form in ("u1", "u2"):
        values = (whole * (1 if form == "u1" else 257)).astype(f"<{form}")
        rows = np.zeros((8, 4), values.dtype)
        rows[:, :2] = values
        view = file.view(rows.tobytes(), byteStride=rows.itemsize * 4)
        accessor = file.accessor(values, view, normalized=True)
    elif form == "sparse":
        expected = np.where(np.arange(8)[:, None] % 2, 0.25, 0.0) * [1, 2]
        rows = expected[1::2].astype("<f4")
        indices = file.view(np.arange(1, 8, 2, dtype="<u2").tobytes())
        sparse = {"count": 4, "indices": {"bufferView": indices, "componentType": 5123}}
        file.json["accessors"].append({"componentType": 5126, "count": 8, "type": "VEC2"})
        file.json["accessors"][-1]["sparse"] = sparse | {"values": {"bufferView": file.view(rows.tobytes())}}
        accessor = len(file.json["accessors"]) - 1
    elif form == "interleaved":
        rows = np.hstack([CUBE, expected]).astype("<f4")
        view = file.view(rows.tobytes(), byteStride=20)
        accessor = file.accessor(rows[:, 3:], view, byteOffset=12)
        attributes["POSITION"] = file.accessor(CUBE, view)
        expected = rows[:, 3:].astype(float)
    else:  # plain integers, which KHR_mesh_quantization allows, for a texture transform to scale
        expected = whole.astype(float)
        accessor = file.accessor(np.hstack([whole, whole]).astype("<u2")[:, :2].copy(), type="VEC2")
    attributes["TEXCOORD_0"] = accessor
    soup = read_gltf(file.glb(), attributes=True)
    assert np.allclose(soup.attributes.vertex["uv"], expected * [1, -1] + [0, 1], rtol=0, atol=1e-15)


def test_texture_coordinates_and_colours_of_draco():
    draco = pytest.importorskip("DracoPy")
    solid, rng = icosahedron(), np.random.default_rng(1)
    uv, color = rng.random((12, 2)), rng.integers(0, 256, (12, 3)).astype("u1")
    exact = {"quantization_bits": 0, "preserve_order": True}
    content = draco.encode(solid.verts.astype("f4"), solid.faces.astype("u4"), tex_coord=uv, colors=color, **exact)
    ids = {entry["attribute_type"]: entry["unique_id"] for entry in draco.decode(content).attributes}
    file = GltfFile()
    compressed = {"bufferView": file.view(content)}
    compressed["attributes"] = {"POSITION": ids[0], "TEXCOORD_0": ids[3], "COLOR_0": ids[2]}
    file.json["accessors"] = [
        {"componentType": 5126, "count": 12, "type": "VEC3"},
        {"componentType": 5126, "count": 12, "type": "VEC2"},
        {"componentType": 5121, "count": 12, "type": "VEC3", "normalized": True},
    ]
    attributes = {"POSITION": 0, "TEXCOORD_0": 1, "COLOR_0": 2}
    file.node(mesh=file.mesh({"attributes": attributes, "extensions": {"KHR_draco_mesh_compression": compressed}}))
    found = read_gltf(file.glb(), attributes=True).attributes.vertex
    assert np.allclose(found["uv"], uv * [1, -1] + [0, 1], atol=1e-3)
    assert np.array_equal(found["color"], color)


def test_several_meshes_give_the_union_with_neutral_values():
    file = GltfFile()
    for shift, name in enumerate(["one", "two", None]):
        primitive = file.primitive((CUBE + 2 * shift).astype("<f4"), CUBE_FACES)
        if shift == 0:
            primitive["attributes"] |= {
                "TEXCOORD_0": file.accessor(np.full((8, 2), 0.25, "<f4")),
                "COLOR_0": file.accessor(np.full((8, 4), 7, "u1"), normalized=True),
                "_HEAT": file.accessor(np.full(8, 3, "<f4")),
            }
            primitive["material"] = 0
        if shift == 1:
            primitive["attributes"]["COLOR_0"] = file.accessor(np.full((8, 3), 0.5, "<f4"))
        file.node(mesh=file.mesh(primitive), **({"name": name} if name else {}))
    file.json["materials"] = [{"name": "red"}]
    file.json["meshes"][1]["name"] = "the node's name goes first"
    with heard() as texts:
        carried = read_gltf(file.glb(), attributes=True).attributes
    assert texts == [
        "only some of its primitives have 'HEAT', colours, texture coordinates; the others get white, or 0"
    ]
    assert carried.vertex["uv"][[0, 8, 16]].tolist() == [[0.25, 0.75], [0, 0], [0, 0]]
    assert np.allclose(carried.vertex["color"][[0, 8, 16]], [[7 / 255] * 4, [0.5] * 3 + [1], [1] * 4])
    assert carried.vertex["HEAT"][[0, 8, 16]].tolist() == [3, 0, 0]
    assert carried.face["material"][[0, 12, 24]].tolist() == [0, -1, -1]
    assert carried.face["group"][[0, 12, 24]].tolist() == [0, 1, -1]
    assert carried.groups == ("one", "two")


def test_primitives_that_share_positions_but_not_texture_coordinates_stay_one_surface(tmp_path):
    file = GltfFile()
    position, color = file.accessor(CUBE), file.accessor(np.full((8, 3), 0.5, "<f4"))
    uv = [file.accessor(np.full((8, 2), value, "<f4")) for value in (0.25, 0.75)]
    primitives = [
        {
            "attributes": {"POSITION": position, "COLOR_0": color, "TEXCOORD_0": coordinates},
            "indices": file.accessor(CUBE_FACES[part].ravel()),
        }
        for coordinates, part in zip(uv, (slice(0, 5), slice(5, 12)), strict=True)
    ]
    del primitives[1]["attributes"]["COLOR_0"]
    file.node(mesh=file.mesh(*primitives), scale=[-1, 1, 1])
    with pytest.warns(MeshfitWarning, match="only some of its primitives have colours"):
        mesh = load_mesh(file.write(tmp_path))
    plain = load_mesh(tmp_path / "a.glb", attributes=False)
    assert mesh.num_verts == 8
    assert np.array_equal(mesh.faces, plain.faces)
    assert mesh.attributes.corner["uv"][:, 1].tolist() == [0.75] * 15 + [0.25] * 21
    assert mesh.attributes.corner["color"][:, 1].tolist() == [0.5] * 15 + [1.0] * 21


FAULTS = {
    "a wrong count": ("TEXCOORD_0", np.zeros((7, 2), "<f4"), {}, "7 rows for 8 vertices"),
    "a wrong type": ("TEXCOORD_0", np.zeros((8, 3), "<f4"), {}, "expected an accessor of type VEC2"),
    "out of its buffer": ("COLOR_0", np.zeros((8, 3), "<f4"), {"count": 90}, "ends at byte"),
    "no colour": ("COLOR_0", np.zeros((8, 4), "i1"), {}, "expected colours of type 5121, 5123 or 5126"),
    "an unknown number type": ("_X", np.zeros((8, 4), "u1"), {"componentType": 1}, "expected one of"),
}


@over("name", FAULTS)
def test_damaged_data_is_left_out_with_one_line(name):
    semantic, values, members, expected = FAULTS[name]
    file = GltfFile.of_cube()
    index = file.accessor(values, **members)
    file.json["meshes"][0]["primitives"][0]["attributes"][semantic] = index
    file.json["meshes"][0]["primitives"][0]["material"] = 4
    assert len(read_gltf(file.glb()).sizes) == 12
    with heard() as texts:
        soup = read_gltf(file.glb(), attributes=True)
    assert not soup.attributes.vertex
    assert len(texts) == 1
    assert texts[0].startswith("left out damaged attributes: ")
    assert "meshes[0].primitives[0] refers to materials[4]" in texts[0]
    file.json["meshes"][0]["primitives"][0].pop("material")
    with heard() as texts:
        read_gltf(file.glb(), attributes=True)
    assert re.search(expected, texts[0])
    assert semantic in texts[0] or "accessors[" in texts[0]


DAMAGED_MATERIALS = {
    "a colour of three numbers": {"pbrMetallicRoughness": {"baseColorFactor": [1, 2, 3]}},
    "no object": {"pbrMetallicRoughness": 3},
    "a texture that does not exist": {"normalTexture": {"index": 7}},
    "a texture by name": {"normalTexture": {"index": "0"}},
    "a texture below zero": {"normalTexture": {"index": -1}},
}


@over("name", DAMAGED_MATERIALS)
def test_damaged_materials_are_left_out_with_one_line(name):
    file, _ = textured_file(**DAMAGED_MATERIALS[name])
    with heard() as texts:
        soup = read_gltf(file.glb(), attributes=True)
    assert len(texts) == 1
    assert "materials[1]" in texts[0]
    assert soup.attributes.materials[0].name == "paint"
    assert encode_mesh(Mesh(soup.verts, soup.corners.reshape(-1, 3), soup.attributes), ".glb")


def test_parts_that_a_mesh_does_not_carry_are_named():
    file = GltfFile.of_cube()
    file.json |= {"animations": [{}], "cameras": [{}], "extensions": {"KHR_lights_punctual": {}}}
    file.json["meshes"][0]["primitives"][0]["targets"] = [{}]
    with heard() as texts:
        read_gltf(file.glb(), attributes=True)
    assert texts[-1] == "a mesh does not carry its animations, cameras, lights, morph targets"
    with heard() as texts:
        read_gltf(file.glb())
    assert texts == ["morph targets move the mesh; reading it with the weights of the file"]


# Skins


def arm(*, bent=False):
    """A bar along x of two joints, the second a child of the first and perhaps bent, under an armature."""
    half = np.sqrt(0.5)
    file = GltfFile()
    bar = CUBE.astype("<f4") * np.array([4, 1, 1], "<f4")
    joints = np.zeros((8, 4), "u1")
    joints[:, 1] = 1
    second = np.where(bar[:, 0] > 2, 0.75, 0.25)
    weights = np.stack([1 - second, second, 0 * second, 0 * second], axis=1).astype("<f4")
    primitive = file.primitive(bar, CUBE_FACES)
    primitive["attributes"] |= {"JOINTS_0": file.accessor(joints), "WEIGHTS_0": file.accessor(weights)}
    file.node(mesh=file.mesh(primitive), skin=0, name="bar")
    file.node(name="armature", scale=[2, 2, 2], translation=[0, 1, 0], children=[2])
    file.node(name="upper", translation=[0.5, 0, 0], children=[3])
    file.node(name="lower", translation=[1, 0, 0], **({"rotation": [0, 0, half, half]} if bent else {}))
    inverse = np.tile(np.eye(4), (2, 1, 1))
    inverse[:, :3, :3] /= 2
    inverse[0, :3, 3], inverse[1, :3, 3] = [-0.5, -0.5, 0], [-1.5, -0.5, 0]
    columns = inverse.transpose(0, 2, 1).reshape(2, 16).astype("<f4")
    file.json["skins"] = [{"joints": [2, 3], "inverseBindMatrices": file.accessor(columns)}]
    return file, bar, weights


@over("bent", [False, True])
def test_a_skin_is_written_at_rest_where_the_mesh_is(tmp_path, bent):
    file, bar, weights = arm(bent=bent)
    with heard() as texts:
        mesh = load_mesh(file.write(tmp_path, "given.glb"))
    assert any("a skin bends the mesh" in text for text in texts) == bent
    assert np.allclose(mesh.verts, bar, atol=1e-6) != bent
    assert np.allclose(mesh.attributes.vertex["weights"], weights)
    moved = mesh.with_verts(mesh.verts * 1.5 + 3)  # a fit has moved it
    with heard() as texts:
        found = there_and_back(moved, tmp_path)
    assert not texts
    assert np.array_equal(found.verts, moved.verts.astype("f4"))
    assert np.array_equal(found.faces, moved.faces)
    assert np.allclose(found.attributes.vertex["weights"], weights, atol=1e-6)
    assert found.attributes.groups == ("bar",)
    nodes, joints = (found.attributes.skin.content[key] for key in ("nodes", "joints"))
    assert [nodes[joint]["name"] for joint in joints] == ["upper", "lower"]
    written = json.loads(encode_mesh(found, ".gltf"))
    names = [node["name"] for node in written["nodes"]]
    children = {node["name"]: [names[child] for child in node.get("children", [])] for node in written["nodes"]}
    assert children == {"bar": [], "armature": ["upper"], "upper": ["lower"], "lower": []}
    assert [names[root] for root in written["scenes"][0]["nodes"]] == ["bar", "armature"]
    # A vertex follows the lower joint, which is turned about the z axis, by its weight.
    lower, position = written["nodes"][names.index("lower")], 2 * np.array([1.5, 0.5, 0])
    _, _, z, w = lower.get("rotation", [0, 0, 0, 1])
    half_sine, half_cosine = np.sin(0.2), np.cos(0.2)
    lower["rotation"] = [0, 0, half_cosine * z + half_sine * w, half_cosine * w - half_sine * z]
    turn = np.array([[np.cos(0.4), -np.sin(0.4), 0], [np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
    (tmp_path / "posed.gltf").write_text(json.dumps(written))
    with pytest.warns(MeshfitWarning, match="a skin bends the mesh"):
        posed = load_mesh(tmp_path / "posed.gltf")
    turned = position + (found.verts - position) @ turn.T
    assert np.allclose(posed.verts, found.verts + weights[:, 1:2] * (turned - found.verts), atol=1e-5)


def test_vertices_without_a_joint_stay_at_rest(tmp_path):
    file, _, _ = arm()
    file.node(mesh=file.mesh(file.primitive((CUBE + 20).astype("<f4"), CUBE_FACES)), name="stone")
    with heard() as texts:
        mesh = load_mesh(file.write(tmp_path, "given.glb"))
    assert any("only some of its primitives have skin weights" in text for text in texts)
    with heard():
        found = there_and_back(mesh, tmp_path)
    assert np.allclose(found.verts, mesh.verts, atol=1e-5)
    nodes, joints = (found.attributes.skin.content[key] for key in ("nodes", "joints"))
    assert [nodes[joint]["name"] for joint in joints] == ["upper", "lower", "rest"]
    with heard():
        again = there_and_back(found, tmp_path)
    assert len(again.attributes.skin.content["joints"]) == 3


def test_two_skins_become_one(tmp_path):
    file, bar, _ = arm()
    first = file.json["meshes"][0]["primitives"][0]
    attributes = first["attributes"] | {"POSITION": file.accessor((bar + np.array([0, 0, 9])).astype("<f4"))}
    file.node(mesh=file.mesh(first | {"attributes": attributes}), skin=1)
    file.json["skins"].append(dict(file.json["skins"][0], joints=[3, 2]))
    with heard():
        mesh = load_mesh(file.write(tmp_path, "given.glb"))
        found = there_and_back(mesh, tmp_path)
    assert set(np.unique(mesh.attributes.vertex["joints"][:8, :2])) == {0, 1}
    assert mesh.attributes.vertex["joints"][8, :2].tolist() == [1, 0]
    assert len(mesh.attributes.skin.content["joints"]) == 2
    assert np.allclose(found.verts, mesh.verts, atol=1e-5)


def test_a_flattened_joint_and_a_foreign_skin_are_named(tmp_path):
    file, _, _ = arm()
    file.json["nodes"][3]["scale"] = [1, 1, 0]
    with heard() as texts:
        mesh = load_mesh(file.write(tmp_path))
    assert "joint" in texts[-1]
    assert mesh.attributes.skin is None
    assert "joints" not in mesh.attributes.vertex
    skinned = icosahedron().with_attributes(
        Attributes(vertex={"joints": np.zeros((12, 1), int), "weights": np.ones((12, 1))}, skin=Skin(".fbx", None))
    )
    with pytest.warns(MeshfitWarning, match="cannot hold the skin; it is left out"):
        save_mesh(skinned, tmp_path / "b.glb")


# Other readers and writers


def test_trimesh_reads_what_is_written(tmp_path):
    import trimesh

    mesh = carrying(icosahedron())
    mesh = mesh.with_attributes(
        Attributes(mesh.attributes.vertex, {"material": np.ones(20, int)}, mesh.attributes.corner,
                   mesh.attributes.materials)
    )  # fmt: skip
    save_mesh(mesh, tmp_path / "a.glb")
    found = trimesh.load_scene(tmp_path / "a.glb", process=False).geometry.popitem()[1]
    corners = found.vertices[found.faces].reshape(-1, 3)
    assert np.array_equal(corners, mesh.verts.astype("f4")[mesh.faces].reshape(-1, 3))
    assert np.allclose(found.visual.uv[found.faces].reshape(-1, 2), mesh.attributes.corner["uv"], atol=1e-6)
    assert np.array_equal(
        found.vertex_attributes["_heat"][found.faces].squeeze(), mesh.attributes.vertex["heat"][mesh.faces]
    )
    assert np.array_equal(found.visual.material.baseColorTexture.convert("RGB"), read_picture(PNG))
    assert found.visual.material.baseColorFactor.tolist() == [0, 0, 255, 128]


def read_picture(content):
    from PIL import Image as Pillow

    return np.asarray(Pillow.open(io.BytesIO(content)).convert("RGB"))


def test_vtk_reads_what_is_written(tmp_path):
    geometry = pytest.importorskip("vtkmodules.vtkIOGeometry")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    mesh = carrying(icosahedron())
    save_mesh(mesh, tmp_path / "a.glb")
    reader = geometry.vtkGLTFReader()
    reader.SetFileName(str(tmp_path / "a.glb"))
    reader.Update()
    surfaces = []

    def collect(block):
        if not hasattr(block, "GetNumberOfBlocks"):
            return surfaces.append(block)
        for number in range(block.GetNumberOfBlocks()):
            collect(block.GetBlock(number))
        return None

    collect(reader.GetOutput())
    triangles, coordinates, colors = [], [], []
    for surface in surfaces:
        cells = vtk_to_numpy(surface.GetPolys().GetConnectivityArray())
        triangles.append(vtk_to_numpy(surface.GetPoints().GetData())[cells])
        coordinates.append(vtk_to_numpy(surface.GetPointData().GetArray("TEXCOORD_0"))[cells])
        colors.append(vtk_to_numpy(surface.GetPointData().GetArray("COLOR_0"))[cells][:, :3])
    triangles, coordinates, colors = map(np.concatenate, (triangles, coordinates, colors))
    found = Mesh(triangles, np.arange(60).reshape(-1, 3), Attributes(corner={"uv": coordinates, "color": colors}))
    assert same_rows(found, flipped(mesh), "uv", tolerance=1e-6)
    (_, values), (_, expected) = placed_rows(found, "color"), placed_rows(mesh, "color")
    assert np.allclose(255 * values, expected, atol=1e-3)


def flipped(mesh):
    uv = mesh.attributes.corner["uv"] * [1, -1] + [0, 1]
    return mesh.with_attributes(Attributes(corner={"uv": uv}))


def test_vtk_sees_a_skin_at_rest_where_the_mesh_is(tmp_path):
    geometry = pytest.importorskip("vtkmodules.vtkIOGeometry")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    file, _, _ = arm(bent=True)
    with heard():
        mesh = load_mesh(file.write(tmp_path, "given.glb"))
    save_mesh(mesh, tmp_path / "a.glb")
    reader = geometry.vtkGLTFReader()
    reader.SetFileName(str(tmp_path / "a.glb"))
    reader.Update()
    surface = reader.GetOutput()
    while hasattr(surface, "GetNumberOfBlocks"):
        surface = surface.GetBlock(0)
    assert np.allclose(vtk_to_numpy(surface.GetPoints().GetData()), mesh.verts, atol=1e-6)


def test_a_file_of_trimesh_is_read(tmp_path):
    import trimesh
    from PIL import Image as Pillow

    solid = icosahedron()
    uv = np.random.default_rng(8).random((12, 2))
    image = Pillow.open(io.BytesIO(PNG))
    material = trimesh.visual.material.PBRMaterial(name="m", baseColorTexture=image, baseColorFactor=[0, 255, 0, 255])
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    given = trimesh.Trimesh(solid.verts, solid.faces, visual=visual, process=False)
    given.vertex_attributes["_heat"] = np.arange(12, dtype="f4")
    given.export(tmp_path / "a.glb")
    mesh = load_mesh(tmp_path / "a.glb")
    assert np.array_equal(mesh.faces, solid.faces)
    assert np.allclose(mesh.attributes.corner["uv"], uv[solid.faces.ravel()], atol=1e-6)
    assert np.array_equal(mesh.attributes.vertex["heat"], np.arange(12))
    assert np.array_equal(read_picture(mesh.attributes.materials[0].texture.content), read_picture(PNG))
    assert mesh.attributes.materials[0].color == (0, 1, 0, 1)


def test_pygltflib_reads_what_is_written_and_is_read(tmp_path):
    pygltflib = pytest.importorskip("pygltflib")
    save_mesh(carrying(icosahedron()), tmp_path / "a.glb")
    found = pygltflib.GLTF2().load(tmp_path / "a.glb")
    assert [node.name for node in found.nodes] == ["lower half", "upper half"]
    assert [len(mesh.primitives) for mesh in found.meshes] == [3, 3]
    view = found.bufferViews[found.images[0].bufferView]
    assert found.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength] == PNG
    found.save(tmp_path / "b.glb")
    one, other = load_mesh(tmp_path / "a.glb"), load_mesh(tmp_path / "b.glb")
    for name in ("uv", "uv1", "color", "heat", "group", "material"):
        assert same_rows(one, other, name)
    assert other.attributes.materials[1].texture.content == PNG
