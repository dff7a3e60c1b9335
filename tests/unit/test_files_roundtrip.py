"""Round trips of meshes through files: to the last bit where the format holds double precision."""

import numpy as np
import pytest

from meshfit.errors import MeshError
from meshfit.mesh.io.files import FORMATS, encode_mesh, load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from tests.loops import over
from tests.shapes import CLOSED

DOUBLE = (".obj", ".ply", ".off")
SCALES = (1.0, 1e-9, 1e9, 1e-30, 1e30, 1 / 3)


def face_points(mesh):
    """The corners of each face, turned so that the smallest comes first, the faces in order."""
    rounds = [np.roll(mesh.verts[mesh.faces], turn, axis=1).reshape(-1, 9).tolist() for turn in range(3)]
    return sorted(min(turns) for turns in zip(*rounds, strict=True))


def again(mesh, path):
    save_mesh(mesh, path)
    return load_mesh(path)


@over("scale", SCALES)
@pytest.mark.parametrize("suffix", DOUBLE)
def test_double_precision_comes_back_to_the_last_bit(tmp_path, suffix, scale):
    mesh = Mesh(CLOSED["mixed"]().verts * scale * np.pi, CLOSED["mixed"]().faces)
    found = again(mesh, tmp_path / f"a{suffix}")
    assert np.array_equal(found.verts, mesh.verts)
    assert np.array_equal(found.faces, mesh.faces)


@over("scale", SCALES)
def test_glb_comes_back_rounded_to_single_precision(tmp_path, scale):
    mesh = Mesh(CLOSED["mixed"]().verts * scale * np.pi, CLOSED["mixed"]().faces)
    found = again(mesh, tmp_path / "a.glb")
    assert np.array_equal(found.verts, mesh.verts.astype(np.float32))
    assert np.array_equal(found.faces, mesh.faces)


@over("scale", SCALES)
@over("shape", CLOSED)
def test_stl_comes_back_as_the_same_faces_welded(tmp_path, shape, scale):
    mesh = Mesh(CLOSED[shape]().verts * scale * np.pi, CLOSED[shape]().faces)
    found = again(mesh, tmp_path / "a.stl")
    assert found.num_verts == mesh.num_verts
    assert face_points(found) == face_points(Mesh(mesh.verts.astype(np.float32), mesh.faces))


@pytest.mark.parametrize("suffix", FORMATS)
@over("shape", CLOSED)
def test_every_closed_shape_survives_every_format(tmp_path, suffix, shape):
    mesh = CLOSED[shape]()
    found = again(mesh, tmp_path / f"a{suffix}")
    assert (found.num_verts, found.num_faces) == (mesh.num_verts, mesh.num_faces)
    assert np.allclose(face_points(found), face_points(mesh), rtol=0, atol=1e-6)


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_same_mesh_gives_the_same_bytes(suffix):
    first, second = (encode_mesh(CLOSED["torus"](), suffix) for _ in range(2))
    assert first == second
    assert first != encode_mesh(Mesh(CLOSED["torus"]().verts * 2, CLOSED["torus"]().faces), suffix)


@pytest.mark.parametrize("suffix", FORMATS)
def test_suffixes_may_be_in_capitals(tmp_path, suffix):
    mesh = CLOSED["cube"]()
    save_mesh(mesh, tmp_path / f"A{suffix.upper()}")
    assert (tmp_path / f"A{suffix.upper()}").read_bytes() == encode_mesh(mesh, suffix)
    assert load_mesh(tmp_path / f"A{suffix.upper()}").num_faces == mesh.num_faces


def test_ply_is_binary_little_endian_and_double(tmp_path):
    mesh = CLOSED["mixed"]()
    save_mesh(mesh, tmp_path / "a.ply")
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    assert header.decode("ascii").splitlines() == [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {mesh.num_verts}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {mesh.num_faces}",
        "property list uchar int vertex_indices",
    ]
    assert len(body) == mesh.num_verts * 24 + mesh.num_faces * 13
    assert np.array_equal(np.frombuffer(body, "<f8", mesh.num_verts * 3).reshape(-1, 3), mesh.verts)
    rows = np.frombuffer(body[mesh.num_verts * 24 :], np.dtype([("count", "u1"), ("index", "<i4", 3)]))
    assert (rows["count"] == 3).all()
    assert np.array_equal(rows["index"], mesh.faces)


@over("suffix", [".stl", ".glb"])
def test_coordinates_beyond_single_precision_are_refused(tmp_path, suffix):
    mesh = Mesh(CLOSED["cube"]().verts * 1e39, CLOSED["cube"]().faces)
    with pytest.raises(MeshError, match=rf"a\{suffix}: {suffix[1:].upper()} holds single precision"):
        save_mesh(mesh, tmp_path / f"a{suffix}")
    assert not (tmp_path / f"a{suffix}").exists()


def test_a_path_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(MeshError, match=r"gone/a\.ply: cannot be written: there is no folder .*gone; create it"):
        save_mesh(CLOSED["cube"](), tmp_path / "gone" / "a.ply")
    with pytest.raises(MeshError, match=r"a\.xyz: unknown mesh format '\.xyz'; allowed: \.obj, \.ply"):
        save_mesh(CLOSED["cube"](), tmp_path / "a.xyz")


def test_a_mesh_holds_copies_that_cannot_be_changed():
    verts, faces = np.eye(3), np.array([[0, 1, 2]], dtype=np.int32)
    mesh = Mesh(verts, faces)
    verts[0] = 9
    assert mesh.verts[0, 0] == 1
    assert (mesh.verts.dtype, mesh.faces.dtype) == (np.float64, np.int64)
    with pytest.raises(ValueError, match="read-only"):
        mesh.verts[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        mesh.faces[0] = 0
