"""glTF files: accessors, primitives, nodes, scenes, compression, containers, and the refusals of invalid ones."""

import base64
import json
import re
import struct
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.files import encode_mesh, load_mesh
from meshfit.mesh.io.gltf import read_gltf
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.targets import file_sha256
from meshfit.mesh.triangulation import triangulate
from tests.gltf import CUBE, CUBE_FACES, GltfFile, glb
from tests.loops import over

STRIP = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]], "<f4")


def read(file, folder=None):
    """Return the triangles of a file, and its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        soup = read_gltf(file if isinstance(file, bytes) else file.glb(), folder)
    assert soup.verts.dtype == np.float64
    assert soup.corners.dtype == soup.sizes.dtype == np.int64
    return Mesh(soup.verts, triangulate(soup.verts, soup.corners, soup.sizes)), [
        str(warning.message) for warning in caught
    ]


def volume(mesh):
    corners = mesh.verts[mesh.faces]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def area_vector(mesh):
    corners = mesh.verts[mesh.faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0) / 2


def refusal(file, folder=None):
    with pytest.raises(MeshError) as caught:
        read(file, folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# Nodes

ROTATION = [0.5, 0.5, 0.5, 0.5]
NODES = {
    "translated": ({"translation": [5, 6, 7]}, 1),
    "rotated": ({"rotation": ROTATION}, 1),
    "scaled": ({"scale": [2, 3, 4]}, 24),
    "mirrored": ({"scale": [-1, 1, 1]}, 1),
    "point reflection": ({"scale": [-1, -1, -1]}, 1),
    "two mirrors": ({"scale": [-1, -1, 1]}, 1),
    "mirrored by a matrix": ({"matrix": [0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]}, 1),
    "all": ({"translation": [5, 6, 7], "rotation": ROTATION, "scale": [2, -3, 0.5]}, 3),
    "a quaternion that is not of length one": ({"rotation": [0, 0, 0, 2]}, 1),
}


@over("name", NODES)
def test_a_cube_keeps_its_outside_under_every_node(name):
    node, expected = NODES[name]
    mesh, caught = read(GltfFile.of_cube(**node))
    assert volume(mesh) == pytest.approx(expected)
    assert not caught


def test_a_rotation_a_scale_and_a_translation_apply_in_this_order():
    file = GltfFile.of_cube(translation=[5, 6, 7], rotation=[0, 0, np.sqrt(0.5), np.sqrt(0.5)], scale=[2, 3, 4])
    mesh, _ = read(file)
    assert np.allclose(mesh.verts[1], [5, 8, 7])
    assert np.allclose(mesh.verts[2], [2, 6, 7])


def test_a_matrix_is_stored_by_columns():
    mesh, _ = read(GltfFile.of_cube(matrix=[1, 2, 3, 0, 4, 5, 6, 0, 7, 8, 10, 0, 11, 12, 13, 1]))
    assert mesh.verts[1].tolist() == [12, 14, 16]


def test_one_mesh_under_a_plain_and_a_mirrored_node():
    file = GltfFile.of_cube()
    file.node(mesh=0, scale=[-1, 1, 1], translation=[-2, 0, 0])
    mesh, _ = read(file)
    assert (mesh.num_faces, volume(mesh)) == (24, 2)


transforms = st.fixed_dictionaries(
    {},
    optional={
        "translation": st.lists(st.integers(-9, 9), min_size=3, max_size=3),
        "rotation": st.lists(st.integers(-3, 3), min_size=4, max_size=4).filter(any),
        "scale": st.lists(st.sampled_from([-2, -1, -0.5, 0.5, 1, 3]), min_size=3, max_size=3),
    },
)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(transforms, st.integers(0, 9), st.booleans()), min_size=1, max_size=8))
def test_the_volume_of_a_scene_graph_is_the_sum_of_its_cubes(nodes):
    """Each node hangs under an earlier one, or is a root."""
    file = GltfFile()
    file.mesh(file.primitive(CUBE, CUBE_FACES))
    scales, expected = [], []
    for number, (transform, above, shown) in enumerate(nodes):
        has_mesh = shown or number == 0
        file.node(**transform, **({"mesh": 0} if has_mesh else {}))
        parent = above - 1 if above <= number else None
        scale = np.prod(transform.get("scale", [1]))
        if parent is not None and parent >= 0:
            file.json["nodes"][parent].setdefault("children", []).append(number)
            scale *= scales[parent]
        scales.append(scale)
        expected += [abs(scale)] if has_mesh else []
    mesh, _ = read(file)
    assert mesh.num_faces == 12 * len(expected)
    starts = np.arange(len(expected)) * 12
    found = [volume(Mesh(mesh.verts, mesh.faces[start : start + 12])) for start in starts]
    assert np.allclose(sorted(found), sorted(expected))
    assert np.allclose(area_vector(mesh), 0, atol=1e-6 * np.abs(mesh.verts).max() ** 2)


# Accessors


@over("columns", [3, 5])
@over("start", [0, 8])
@over("kind", ["i1", "u1", "i2", "u2", "f4"])
@over("normalized", [False, True])
def test_positions_of_every_type_plain_and_interleaved(kind, start, columns, normalized):
    dtype = np.dtype(f"<{kind}")
    largest = 9 if dtype.kind == "f" else np.iinfo(dtype).max
    rows = np.zeros((8, columns), dtype)
    rows[:, :3] = CUBE.astype(dtype) * largest
    stride = {} if columns == 3 else {"byteStride": rows.strides[0]}
    file = GltfFile()
    view = file.view(bytes(start) + rows.tobytes(), **stride)
    position = file.accessor(rows[:, :3], view, byteOffset=start, normalized=normalized)
    file.node(mesh=file.mesh({"attributes": {"POSITION": position}, "indices": file.accessor(CUBE_FACES.ravel())}))
    file.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    mesh, _ = read(file)
    assert volume(mesh) == pytest.approx(1 if normalized and dtype.kind != "f" else largest**3)


def test_the_smallest_normalized_integer_is_minus_one():
    file = GltfFile()
    position = file.accessor(np.array([[-128, -127, 127], [0, 0, 0], [64, 0, 0]], "i1"), normalized=True)
    file.node(mesh=file.mesh({"attributes": {"POSITION": position}}))
    mesh, _ = read(file)
    assert np.array_equal(mesh.verts, [[-1, -1, 1], [0, 0, 0], [64 / 127, 0, 0]])


@over("kind", ["u1", "u2", "u4"])
def test_indices_of_every_type(kind):
    file = GltfFile()
    file.node(mesh=file.mesh(file.primitive(CUBE, CUBE_FACES.astype(f"<{kind}"))))
    assert volume(read(file)[0]) == 1


@over("base", [True, False])
@over("kind", ["u1", "u2", "u4"])
def test_sparse_positions_with_and_without_a_base(kind, base):
    file = GltfFile.of_cube()
    replaced = np.arange(8) if not base else np.array([3, 7])
    sparse = {
        "count": len(replaced),
        "indices": {
            "bufferView": file.view(replaced.astype(f"<{kind}").tobytes()),
            "componentType": {"u1": 5121, "u2": 5123, "u4": 5125}[kind],
        },
        "values": {"bufferView": file.view((CUBE[replaced] * 2).tobytes())},
    }
    accessor = file.json["accessors"][0]
    accessor["sparse"] = sparse
    if not base:
        del accessor["bufferView"]
    expected = CUBE.astype(float)
    expected[replaced] *= 2
    assert np.array_equal(read(file)[0].verts, expected)


# Primitives

FAN_TRIANGLES = {(1, 2, 0), (2, 3, 0), (3, 4, 0)}
STRIP_TRIANGLES = {(0, 1, 2), (1, 3, 2), (2, 3, 4)}


@over("indexed", [True, False])
@over(("mode", "expected"), [(5, STRIP_TRIANGLES), (6, FAN_TRIANGLES)])
def test_strips_alternate_and_fans_turn_about_their_first_vertex(indexed, mode, expected):
    file = GltfFile()
    file.node(mesh=file.mesh(file.primitive(STRIP, np.arange(5, dtype="<u2") if indexed else None, mode=mode)))
    assert {tuple(face) for face in read(file)[0].faces.tolist()} == expected


def test_a_strip_that_repeats_corners_goes_on_elsewhere():
    file = GltfFile()
    corners = np.array([0, 1, 2, 2, 4, 4, 3, 2], "<u2")
    file.node(mesh=file.mesh(file.primitive(STRIP, corners, mode=5)))
    assert {frozenset(face) for face in read(file)[0].faces.tolist()} == {frozenset({0, 1, 2}), frozenset({2, 3, 4})}


def test_primitives_of_all_modes_side_by_side():
    file = GltfFile()
    moved = [file.primitive(STRIP + np.float32(mode), mode=mode) for mode in range(5)]
    moved[4] = file.primitive(CUBE, CUBE_FACES)
    strip, fan = file.primitive(STRIP[:4], mode=5), file.primitive(STRIP[[0, 1, 3, 2]], mode=6)
    file.node(mesh=file.mesh(*moved, strip, fan))
    mesh, caught = read(file)
    assert (mesh.num_faces, mesh.num_verts) == (16, 16)
    assert np.allclose(area_vector(mesh), [0, 0, 2])
    assert caught == ["passed over 4 primitives of points and lines"]


def test_primitives_with_the_same_positions_share_their_vertices():
    file = GltfFile.of_cube()
    first = file.json["meshes"][0]["primitives"][0]
    second = first | {"indices": file.accessor(CUBE_FACES[6:].ravel())}
    file.json["meshes"][0]["primitives"] = [first | {"indices": file.accessor(CUBE_FACES[:6].ravel())}, second]
    mesh, _ = read(file)
    assert (mesh.num_verts, volume(mesh)) == (8, 1)


def test_corners_after_the_last_whole_triangle_are_counted():
    file = GltfFile()
    file.node(mesh=file.mesh(file.primitive(STRIP)))
    mesh, caught = read(file)
    assert mesh.num_faces == 1
    assert caught == ["meshes[0].primitives[0]: ignored 2 corners after the last whole triangle"]


def test_points_and_lines_alone_give_their_vertices():
    file = GltfFile()
    file.node(mesh=file.mesh(file.primitive(STRIP, mode=0)))
    assert read(file)[0].verts.tolist() == STRIP.tolist()


# Scenes


def test_the_default_scene_is_read_else_the_first_else_all_nodes_else_all_meshes():
    file = GltfFile.of_cube()
    file.node(mesh=0, scale=[2, 2, 2])
    file.json |= {"scenes": [{"nodes": [0]}, {"nodes": [1]}], "scene": 1}
    mesh, caught = read(file)
    assert volume(mesh) == 8
    assert caught == ["2 scenes; reading scene 1", "passed over 1 node with a mesh outside the scene"]
    del file.json["scene"]
    assert volume(read(file)[0]) == 1
    del file.json["scenes"]
    assert volume(read(file)[0]) == 9
    file.mesh(file.primitive(CUBE, CUBE_FACES))
    assert read(file)[1] == ["passed over 1 mesh that no node uses"]
    del file.json["nodes"]
    assert (volume(read(file)[0]), read(file)[1]) == (2, [])


def test_a_scene_without_the_meshes_is_refused():
    file = GltfFile.of_cube()
    file.json["scenes"] = [{}]
    assert refusal(file) == "the scene shows none of the 1 nodes that have a mesh"


def test_repeated_meshes_of_one_node():
    file = GltfFile.of_cube(scale=[2, 1, 1])
    attributes = {
        "TRANSLATION": file.accessor(np.array([[0, 0, 0], [5, 0, 0], [9, 0, 0]], "<f4")),
        "ROTATION": file.accessor(np.array([[0, 0, 0, 127], [0, 0, 127, 0], [127, 0, 0, 0]], "<i1"), normalized=True),
        "SCALE": file.accessor(np.array([[1, 1, 1], [1, 1, 2], [-1, 1, 1]], "<f4")),
    }
    file.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    file.json["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    mesh, _ = read(file)
    assert volume(mesh) == pytest.approx(2 + 4 + 2)
    assert mesh.verts[8:16].max(axis=0) == pytest.approx([10, 0, 2])


def test_a_skin_takes_the_pose_of_its_joints():
    """The node of the mesh moves nothing; the upper half of the cube follows the second joint."""
    file = GltfFile.of_cube(scale=[9, 9, 9], skin=0)
    file.node(translation=[5, 0, 0], children=[2])
    file.node(translation=[0, 0, 3])
    inverse = np.tile(np.eye(4, dtype="<f4").ravel(), (2, 1))
    inverse[:, 12] = -5
    inverse[1, 14] = -1
    file.json["skins"] = [{"joints": [1, 2], "inverseBindMatrices": file.accessor(inverse)}]
    joints = np.zeros((8, 4), "u1")
    joints[4:, 0] = 1
    weights = np.tile(np.array([255, 0, 0, 0], "u1"), (8, 1))
    attributes = {"JOINTS_0": file.accessor(joints), "WEIGHTS_0": file.accessor(weights, normalized=True)}
    file.json["meshes"][0]["primitives"][0]["attributes"] |= attributes
    mesh, caught = read(file)
    assert volume(mesh) == pytest.approx(3)
    assert caught == ["a skin bends the mesh; reading it in the pose of the file's nodes"]


def test_morph_targets_have_the_weights_of_the_file():
    file = GltfFile.of_cube()
    file.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": file.accessor(CUBE)}]
    assert volume(read(file)[0]) == 1
    file.json["meshes"][0]["weights"] = [1]
    mesh, caught = read(file)
    assert volume(mesh) == 8
    assert caught == ["morph targets move the mesh; reading it with the weights of the file"]
    file.json["nodes"][0]["weights"] = [2]
    assert volume(read(file)[0]) == 27


# Extensions and compression


@over("name", ["KHR_materials_unlit", "KHR_texture_basisu", "KHR_lights_punctual", "KHR_materials_variants", "KHR_xmp"])
def test_required_extensions_that_move_no_vertex_do_not_hinder(name):
    file = GltfFile.of_cube()
    file.json["extensionsRequired"] = [name]
    assert volume(read(file)[0]) == 1


@over("name", ["CESIUM_RTC", "KHR_new_geometry", "ACME_mesh_compression", "KHR_node_visibility"])
def test_other_required_extensions_are_refused_by_name(name):
    file = GltfFile.of_cube()
    file.json["extensionsRequired"] = ["KHR_materials_unlit", name]
    assert refusal(file).startswith(f"requires {name}, which is not supported; export ")


def half_draco(data):
    file = GltfFile.of_cube()
    first = file.json["meshes"][0]["primitives"][0]
    for accessor in list(file.json["accessors"]):
        file.json["accessors"].append({key: value for key, value in accessor.items() if key != "bufferView"})
    extension = {"KHR_draco_mesh_compression": {"bufferView": file.view(data), "attributes": {"POSITION": 0}}}
    second = {"attributes": {"POSITION": 2}, "indices": 3, "extensions": extension}
    file.json["meshes"][0]["primitives"] = [first, second]
    file.json["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return file


def test_draco_is_decoded():
    draco = pytest.importorskip("DracoPy")
    file = half_draco(draco.encode(CUBE + np.float32(5), CUBE_FACES.astype("<u4"), quantization_bits=20))
    mesh, _ = read(file)
    assert (mesh.num_faces, volume(mesh)) == (24, pytest.approx(2, rel=1e-5))


def test_draco_that_is_damaged_is_refused_by_name():
    pytest.importorskip("DracoPy")
    assert refusal(half_draco(b"no draco")).endswith("primitives[1]: its KHR_draco_mesh_compression data is damaged")


def test_a_missing_decoder_is_named_with_the_remedy(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "DracoPy", None)
    message = refusal(half_draco(b"draco"))
    assert "KHR_draco_mesh_compression needs a decoder: pip install 'meshfit[gltf]', or export the file" in message
    monkeypatch.setitem(__import__("sys").modules, "meshoptimizer", None)
    message = refusal(meshopt_cube(*MESHOPT_VIEWS["damaged"]))
    assert "EXT_meshopt_compression needs a decoder" in message


MESHOPT_VIEWS = {"damaged": (b"a", b"b", "NONE")}


def meshopt_cube(positions, indices, form, name="EXT_meshopt_compression", mode="TRIANGLES"):
    file = GltfFile()
    rows = [(positions, 8, 12, "ATTRIBUTES", form), (indices, 36, 2, mode, "NONE")]
    for data, count, stride, mode_, filter_ in rows:
        start = file.json["bufferViews"][file.view(data)]
        compressed = start | {"byteStride": stride, "count": count, "mode": mode_, "filter": filter_}
        start |= {"buffer": 1, "byteOffset": 0, "byteLength": count * stride, "extensions": {name: compressed}}
        if mode_ == "ATTRIBUTES":
            start["byteStride"] = stride
    file.json["buffers"].append({"byteLength": 200, "extensions": {name: {"fallback": True}}})
    attributes = {"POSITION": file.accessor(CUBE, view=0)}
    file.node(mesh=file.mesh({"attributes": attributes, "indices": file.accessor(CUBE_FACES.ravel(), view=1)}))
    file.json["extensionsRequired"] = [name]
    return file


@over("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
@over("mode", ["TRIANGLES", "INDICES"])
@over("form", ["NONE", "EXPONENTIAL"])
def test_meshopt_is_decoded(form, mode, name):
    codec = pytest.importorskip("meshoptimizer")
    # Exponential: a signed exponent of 2 in the highest byte, and the number in the others.
    rows = CUBE if form == "NONE" else ((CUBE.astype("<u4") * 8) | (0xFD << 24)).view("<f4")
    encode = codec.encode_index_buffer if mode == "TRIANGLES" else codec.encode_index_sequence
    file = meshopt_cube(codec.encode_vertex_buffer(rows), encode(CUBE_FACES.ravel(), 36, 8), form, name, mode)
    assert volume(read(file)[0]) == 1


@over(("change", "expected"), [
    ({"count": 2**40}, "far more than the file can hold"),
    ({"mode": "SOMETHING"}, "mode 'SOMETHING' with byteStride 12"),
    ({"byteStride": 13}, "byteStride 13"),
    ({"filter": "OCTAHEDRAL"}, "the filter 'OCTAHEDRAL'"),
    ({}, "data is damaged"),
])  # fmt: skip
def test_meshopt_that_is_damaged_is_refused(change, expected):
    codec = pytest.importorskip("meshoptimizer")
    data = codec.encode_vertex_buffer(CUBE)
    file = meshopt_cube(data if change else data[:-9], b"indices", "NONE")
    file.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"] |= change
    assert expected in refusal(file)


# Containers


@over("name", ["a.gltf", "a.glb"])
@over("buffer", ["a.bin", "some%20folder/a%C3%A4.bin", "some folder/aä.bin"])
def test_buffers_beside_the_file(tmp_path, name, buffer):
    file = GltfFile.of_cube()
    path = tmp_path / "a.bin" if buffer == "a.bin" else tmp_path / "some folder" / "aä.bin"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(file.binary)
    file.json["buffers"][0]["uri"] = buffer
    content = json.dumps(file.json).encode()
    (tmp_path / name).write_bytes(content if name == "a.gltf" else glb(file.json))
    assert volume(load_mesh(tmp_path / name)) == 1
    path.unlink()
    with pytest.raises(MeshError, match=re.escape(f"buffers[0]: its file {buffer!r} is missing in {tmp_path}")
                       if buffer == "a.bin" else "missing"):  # fmt: skip
        load_mesh(tmp_path / name)


@over("uri", ["/etc/passwd", "../a.bin", "x/%2e%2e/../a.bin", "http://a.b/c.bin", "file:///a.bin", "C:\\a.bin", ""])
def test_buffers_elsewhere_are_refused(tmp_path, uri):
    file = GltfFile.of_cube()
    file.json["buffers"][0]["uri"] = uri
    assert refusal(file, tmp_path).startswith("buffers[0].uri: expected a file in the folder of the mesh, got '")


def test_a_buffer_in_a_data_uri():
    file = GltfFile.of_cube()
    body = base64.b64encode(file.binary).decode()
    file.json["buffers"][0]["uri"] = f"data:application/gltf-buffer;base64,{body}"
    assert volume(read(json.dumps(file.json).encode())[0]) == 1
    file.json["buffers"][0]["uri"] = f"data:;base64,{body[:-3]}"
    assert refusal(file) == "buffers[0].uri: its base64 is damaged"


def test_the_identity_of_a_target_includes_the_buffers_beside_it(tmp_path):
    path = GltfFile.of_cube().write(tmp_path, "a.gltf")
    before = file_sha256(path)
    (tmp_path / "a.bin").write_bytes((tmp_path / "a.bin").read_bytes() + b"more")
    assert file_sha256(path) != before


def cube_of_two_chunks():
    file = GltfFile.of_cube()
    return file.json, file.binary


def test_padding_and_further_chunks_of_a_binary_file_are_ignored():
    document, binary = cube_of_two_chunks()
    content = glb(document, binary)
    more = struct.pack("<I", 8) + b"MORE" + bytes(8)
    longer = content[:8] + struct.pack("<I", len(content) + len(more)) + content[12:] + more
    assert volume(read(longer)[0]) == 1
    mesh, caught = read(content + b"tail")
    assert volume(mesh) == 1
    assert caught == [f"its header announces {len(content)} bytes; ignored the 4 bytes after them"]


def test_text_in_a_file_named_binary_and_the_reverse(tmp_path):
    file = GltfFile.of_cube()
    (tmp_path / "a.gltf").write_bytes(file.glb())
    file.json["buffers"][0]["uri"] = "data:;base64," + base64.b64encode(file.binary).decode()
    (tmp_path / "a.glb").write_bytes(b"\xef\xbb\xbf" + json.dumps(file.json).encode())
    assert volume(load_mesh(tmp_path / "a.gltf")) == volume(load_mesh(tmp_path / "a.glb")) == 1


def damaged_containers():
    document, binary = cube_of_two_chunks()
    good = glb(document, binary)
    length = len(good)
    json_length = struct.unpack_from("<I", good, 12)[0]
    bin_start = 20 + json_length
    return {
        "version": (glb(document, binary, version=1), "version 1 of glTF; expected version 2"),
        "json version": (glb(document | {"asset": {"version": "1.0"}}, binary), "version 1.0 of glTF; expected 2.0"),
        "cut": (good[:-9], f"cut short: its header announces {length} bytes, but the file has {length - 9}"),
        "header": (good[:11], "cut short within its header: 11 bytes"),
        "chunk": (
            good[:bin_start] + struct.pack("<I", 999) + good[bin_start + 4 :],
            "chunk 1 announces 999 bytes, but",
        ),
        "no json": (good[:16] + b"ABCD" + good[20:], "expected one JSON chunk, and that as the first"),
        "no chunk": (b"glTF" + struct.pack("<II", 2, 12), "expected one JSON chunk"),
        "no bin": (glb(document), "buffers[0] has no data: no 'uri', and no BIN chunk"),
        "short bin": (
            glb(document, binary[:100]),
            f"buffers[0] announces {len(binary)} bytes, but the BIN chunk has 100",
        ),
        "json": (good.replace(b'"asset":', b'"asset",'), "its JSON is damaged at line 1, column"),
        "deep": (b"[" * 100_000, "its JSON is damaged"),
        "long": (b'{"asset": ' + b"9" * 9999 + b"}", "its JSON is damaged"),
        "list": (b"[1]", "expected a JSON object, got a list"),
        "nan": (b'{"asset": NaN}', "its JSON holds NaN"),
        "latin": (b'{"asset": "\xe4"}', "its JSON is not UTF-8 text: byte 11"),
        "other": (b'{"name": "x"}', "expected members 'asset' and 'meshes', got neither"),
        "empty": (b'{"asset": {"version": "2.0"}}', "no meshes in it"),
    }


def test_damaged_containers_are_refused_by_the_numbers():
    for name, (content, expected) in damaged_containers().items():
        assert expected in refusal(content), name


def changed(path, value):
    """Return a cube whose JSON has another value at a place such as `accessors.0.count`."""
    file = GltfFile.of_cube()
    *parents, last = [int(key) if key.isdigit() else key for key in path.split(".")]
    owner = file.json
    for key in parents:
        owner = owner[key]
    if value is None:
        del owner[last]
    else:
        owner[last] = value
    return file


FAULTS = [
    ("accessors.0.count", 9, "accessors[0] ends at byte 108 of bufferViews[0], which has 96 bytes"),
    ("accessors.0.count", 10**12, "accessors[0] ends at byte"),
    ("accessors.0.count", "x", "accessors[0].count: expected an integer of at least 1, got 'x'"),
    ("accessors.0.count", 0, "accessors[0].count: expected an integer of at least 1, got 0"),
    ("accessors.0.byteOffset", 4, "accessors[0] ends at byte 100 of"),
    ("accessors.0.byteOffset", -4, "accessors[0].byteOffset: expected an integer of at least 0"),
    ("accessors.0.bufferView", None, "accessors[0] has no data: neither 'bufferView' nor 'sparse'"),
    ("accessors.0.bufferView", 7, "accessors[0] refers to bufferViews[7], but the file has 2 bufferViews"),
    ("accessors.0.componentType", 5130, "accessors[0].componentType: expected one of 5120, 5121"),
    ("accessors.0.type", "VEC2", "expected an accessor of type VEC3, got accessors[0] of type VEC2"),
    ("accessors.0.sparse", {"count": 1}, "accessors[0].sparse: expected 'indices' and 'values'"),
    ("accessors.1.componentType", 5122, "indices: expected unsigned integers"),
    ("bufferViews.0.byteStride", 8, "bufferViews[0].byteStride is 8, but accessors[0] has elements of 12 bytes"),
    ("bufferViews.0.byteLength", 999, "bufferViews[0] ends at byte 999 of buffers[0], which has 168 bytes"),
    ("bufferViews.0.buffer", 1, "bufferViews[0] refers to buffers[1], but the file has 1 buffers"),
    ("buffers.0.byteLength", 999, "buffers[0] announces 999 bytes, but the BIN chunk has 168"),
    ("buffers", {}, "buffers: expected a list, got an object"),
    ("meshes.0.primitives.0.attributes", {}, "meshes[0].primitives[0]: no POSITION among its attributes"),
    ("meshes.0.primitives.0.mode", 7, "meshes[0].primitives[0].mode: expected 0 to 6, got 7"),
    ("meshes.0.primitives.0.indices", 5, "indices refers to accessors[5], but the file has 2 accessors"),
    ("nodes.0.mesh", 3, "nodes[0] refers to meshes[3], but the file has 1 meshes"),
    ("nodes.0.children", [0], "nodes[0] is among its own ancestors"),
    ("nodes.0.children", [4], "nodes[0].children refers to nodes[4]"),
    ("nodes.0.scale", [1, 1], "nodes[0].scale: expected 3 numbers, got '2 values'"),
    ("nodes.0.scale", [1, 1, True], "nodes[0].scale: expected numbers, got true"),
    ("nodes.0.rotation", [0, 0, 0, 0], "nodes[0]: expected a rotation by a unit quaternion, got one of length 0"),
    ("nodes.0.matrix", [1] * 16, "nodes[0].matrix: expected a last row of 0 0 0 1"),
    ("scenes", [{"nodes": [0, 0]}], "scenes[0].nodes: a node is listed twice"),
]


def test_faults_are_named_by_their_place():
    for path, value, expected in FAULTS:
        assert expected in refusal(changed(path, value)), (path, value)


def test_indices_out_of_range_and_restarts_are_refused():
    corners = CUBE_FACES.ravel().copy()
    corners[5] = 8
    file = GltfFile()
    file.node(mesh=file.mesh(file.primitive(CUBE, corners)))
    assert refusal(file) == "meshes[0].primitives[0]: index 8, but its POSITION has 8 vertices"
    corners[5] = 65535
    file = GltfFile()
    file.node(mesh=file.mesh(file.primitive(CUBE, corners)))
    assert refusal(file).endswith("indices: 65535 restarts a primitive, which glTF does not allow")


def test_two_parents_and_a_scene_of_inner_nodes_are_refused():
    file = GltfFile.of_cube(children=[1])
    file.node()
    file.node(children=[1])
    assert refusal(file) == "nodes[1] is a child twice: of nodes[0] and nodes[2]"
    file.json["nodes"][2] = {}
    file.json["scenes"] = [{"nodes": [1]}]
    assert refusal(file) == "scenes[0].nodes: expected root nodes, got a child of nodes[0]"


def test_a_small_file_cannot_announce_a_giant():
    file = GltfFile.of_cube()
    del file.json["accessors"][0]["bufferView"]
    zeros = {"bufferView": 0, "componentType": 5121}
    file.json["accessors"][0] |= {"count": 10**9, "sparse": {"count": 1, "indices": zeros, "values": {"bufferView": 0}}}
    assert refusal(file) == "accessors[0] announces 24000000000 bytes, far more than the file can hold"
    file = GltfFile.of_cube()
    attributes = {"TRANSLATION": file.accessor(np.zeros((2000, 3), "<f4"))}
    for _ in range(100):
        file.node(mesh=0, extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    assert refusal(file).startswith("its scene repeats the meshes far more often")


# Writing


@over("suffix", [".glb", ".gltf"])
@over("count", [12, 70_000])
def test_other_readers_read_what_is_written(tmp_path, suffix, count):
    import trimesh

    mesh = icosahedron()
    if count > 12:
        rng = np.random.default_rng(1)
        mesh = Mesh(rng.normal(size=(count, 3)), np.arange(count - count % 3).reshape(-1, 3))
    content = encode_mesh(mesh, suffix)
    assert content == encode_mesh(mesh, suffix)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    found = trimesh.load_scene(path, process=False).geometry.popitem()[1]
    assert np.array_equal(found.vertices, mesh.verts.astype(np.float32))
    assert np.array_equal(found.faces, mesh.faces)
    soup = read_gltf(content)
    assert np.array_equal(soup.verts, mesh.verts.astype(np.float32))
    assert np.array_equal(soup.corners, mesh.faces.ravel())


def test_what_is_written_is_valid_to_vtk_too(tmp_path):
    vtk = pytest.importorskip("vtkmodules.vtkIOGeometry")
    (tmp_path / "a.glb").write_bytes(encode_mesh(icosahedron(), ".glb"))
    reader = vtk.vtkGLTFReader()
    reader.SetFileName(str(tmp_path / "a.glb"))
    reader.Update()
    assert reader.GetOutput().GetNumberOfBlocks() == 1


def test_the_warnings_name_the_file(tmp_path):
    file = GltfFile.of_cube()
    file.json["scenes"] = [{"nodes": [0]}, {"nodes": []}]
    with pytest.warns(MeshfitWarning, match=re.escape(f"{tmp_path / 'a.glb'}: 2 scenes; reading scene 0")):
        load_mesh(file.write(tmp_path))
