"""Files of points as targets: normals where a file has them, and one clear line or warning for what cannot be used."""

import struct

import numpy as np
import pytest

import meshfit
from meshfit.errors import MeshError, MeshfitWarning, NoFacesError
from meshfit.mesh.any_target import as_mesh_or_points, require_mesh
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.io.mesh_file import MeshFile
from meshfit.mesh.io.point_clouds import encode_point_cloud, load_point_cloud, read_written_points, save_point_cloud
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud, oriented_cloud
from meshfit.mesh.solids import cube, octahedron
from meshfit.mesh.targets import load_target
from meshfit.subdivision.sphere import icosphere
from tests.gltf import GltfFile
from tests.loops import over

RNG = np.random.default_rng(0)
NORMALS = RNG.normal(size=(30, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
POINTS = 2 * NORMALS
BOTH = np.hstack([POINTS, NORMALS])


def text(*columns, separator=" "):
    return "\n".join(separator.join(map(repr, row)) for row in np.hstack(columns).tolist()) + "\n"


def pcd(rows, fields):
    count = len(fields.split())
    head = f"VERSION 0.7\nFIELDS {fields}\nSIZE{' 8' * count}\nTYPE{' F' * count}\nCOUNT{' 1' * count}\n"
    head += f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA "
    return head.encode() + b"ascii\n" + text(rows).encode(), head.encode() + b"binary\n" + rows.tobytes()


def vtk(*after):
    head = "# vtk DataFile Version 3.0\npoints\nASCII\nDATASET POLYDATA\nPOINTS 30 double\n" + text(POINTS)
    return head + "POINT_DATA 30\nSCALARS i float 1\nLOOKUP_TABLE default\n" + "1\n" * 30 + "\n".join(after)


def vtp(normals):
    array = f'<DataArray type="Float64" Name="N" NumberOfComponents="3">{text(NORMALS)}</DataArray>'
    points = f'<Points><DataArray type="Float64">{text(POINTS)}</DataArray></Points>'
    piece = f'<Piece NumberOfPoints="30"><PointData{normals}>{array}</PointData>{points}</Piece>'
    return f'<VTKFile type="PolyData"><PolyData>{piece}</PolyData></VTKFile>'


def las(extra, *columns):
    """A LAS file of point format 0 with extra bytes, each a name, a number of a type, and a scale or None."""
    records = b""
    for name, kind, scale in extra:
        record = bytearray(192)
        record[2:4], record[4 : 4 + len(name)] = bytes([kind, 8 if scale else 0]), name.encode()
        struct.pack_into("<d", record, 112, scale or 0)
        records += bytes(record)
    record = struct.pack("<2x16sHH32x", b"LASF_Spec", 4, len(records)) + records
    rows = [np.round(POINTS * 1e6).astype("<i4"), np.zeros((30, 8), "u1"), *columns]
    body = np.concatenate([np.ascontiguousarray(row).view("u1").reshape(30, -1) for row in rows], axis=1)
    header = bytearray(227)
    header[:4], header[24:26] = b"LASF", bytes([1, 2])
    struct.pack_into("<HIIBHI", header, 94, 227, 227 + len(record), 1, 0, body.shape[1], 30)
    struct.pack_into("<6d", header, 131, *[1e-6] * 3, *[0.0] * 3)
    return bytes(header) + record + body.tobytes()


def glb(**node):
    file = GltfFile()
    primitive = file.primitive(POINTS.astype("<f4"), mode=0)
    primitive["attributes"]["NORMAL"] = file.accessor(NORMALS.astype("<f4"))
    file.node(mesh=file.mesh(primitive), **node)
    return file.glb()


COLOURS = RNG.integers(0, 256, (30, 3)).astype(float)
PCD_FIELDS = "x y z normal_x normal_y normal_z"
WITH_NORMALS = {
    "a.xyz": text(BOTH),
    "a.xyzn": text(BOTH),
    "colours.txt": text(POINTS, COLOURS, NORMALS),
    "meshlab.txt": text(POINTS, NORMALS, COLOURS),
    "names.csv": "nx,ny,nz,x,y,z\n" + text(NORMALS * 5, POINTS, separator=","),
    "text.pcd": pcd(BOTH, PCD_FIELDS)[0],
    "binary.pcd": pcd(BOTH, PCD_FIELDS)[1],
    "a.ply": encode_point_cloud(PointCloud(POINTS, NORMALS)),
    "a.obj": encode_point_cloud(PointCloud(POINTS, NORMALS), ".obj"),
    "a.off": "NOFF\n30 0 0\n" + text(BOTH),
    "colours.off": "CNOFF\n30 0 0\n" + text(BOTH, COLOURS, COLOURS[:, :1]),
    "a.vtk": vtk("NORMALS n double", text(NORMALS)),
    "field.vtk": vtk("VECTORS v float", text(POINTS), "FIELD f 1", "Normals 3 30 double", text(NORMALS)),
    "a.vtp": vtp(' Normals="N"'),
    "a.glb": glb(),
    "a.las": las([("NormalX", 9, None), ("NormalY", 9, None), ("NormalZ", 9, None)], NORMALS.astype("<f4")),
    "array.las": las([("id", 1, None), ("normals", 30, None)], np.zeros((30, 1), "u1"), NORMALS),
    "scaled.las": las([(f"n{axis}", 4, 1e-4) for axis in "xyz"], np.round(NORMALS * 1e4).astype("<i2")),
}
WITHOUT = {
    "a.xyz": text(POINTS),
    "a.xyzrgb": text(POINTS, NORMALS),
    "colours.xyz": text(POINTS, COLOURS),
    "colours.obj": "".join(f"v {line}\n" for line in text(POINTS, COLOURS / 255).splitlines()),
    "a.ply": encode_point_cloud(PointCloud(POINTS)),
    "zero.xyzn": text(POINTS, 0 * NORMALS),
    "nan.xyzn": text(POINTS, np.nan * NORMALS),
    "unnamed.vtp": vtp("").replace('"N"', '"other"'),
    "index.csv": ",x,y,z\n"
    + "".join(f"{number},{line}\n" for number, line in enumerate(text(POINTS, separator=",").split())),
    "words.txt": "".join(f"{line} a b c\n" for line in text(POINTS).splitlines()),
}


def written(folder, name, content):
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / name


@over("name", WITH_NORMALS)
def test_normals_of_a_file_are_read(tmp_path, name):
    for cloud in (load_target(written(tmp_path, name, WITH_NORMALS[name])), load_point_cloud(tmp_path / name)):
        single = name.endswith(("glb", "las"))
        assert np.allclose(cloud.verts, POINTS, atol=1e-6 if single else 1e-12)
        assert np.allclose(cloud.normals, NORMALS, atol=1e-4 if single else 1e-12)


@over("name", WITHOUT)
def test_other_columns_are_no_normals(tmp_path, name):
    cloud = load_target(written(tmp_path, name, WITHOUT[name]))
    assert np.allclose(cloud.verts, POINTS, atol=1e-12)
    assert cloud.normals is None


def test_points_are_written_and_read_to_the_last_bit(tmp_path):
    for normals in (None, NORMALS * 3):
        cloud = PointCloud(POINTS + 1e6, normals)
        again = read_written_points(MeshFile("a", ".ply", encode_point_cloud(cloud)))
        assert again.verts.tobytes() == cloud.verts.tobytes()
        assert normals is None or again.normals.tobytes() == cloud.normals.tobytes()
    assert read_written_points(MeshFile("a", ".ply", meshfit.mesh.io.files.encode_mesh(cube(), ".ply"))) is None
    save_point_cloud(cloud, tmp_path / "a.obj")
    assert load_target(tmp_path / "a.obj").num_verts == 30
    with pytest.raises(MeshError, match="points are written as PLY or OBJ"):
        save_point_cloud(cloud, tmp_path / "a.stl")


def test_the_normals_of_a_scene_are_turned_as_its_points_are(tmp_path):
    cloud = load_target(written(tmp_path, "a.glb", glb(scale=[-1, 2, 1])))
    normals = NORMALS * [-1, 0.5, 1]
    assert np.allclose(cloud.verts, POINTS * [-1, 2, 1], atol=1e-6)
    assert np.allclose(cloud.normals, normals / np.linalg.norm(normals, axis=1, keepdims=True), atol=1e-6)


def test_points_far_from_the_origin_keep_their_shape(tmp_path):
    far = np.array([4.5e6, -6.1e6, 312.0])
    cloud = load_target(written(tmp_path, "a.xyz", text(POINTS + far)))
    assert np.allclose(cloud.verts - far, POINTS, atol=1e-8)
    assert (np.einsum("nk,nk->n", oriented_cloud(cloud).normals, NORMALS) > 0).mean() > 0.8


WARNED = {
    "nan.ply": (encode_point_cloud(PointCloud(np.vstack([POINTS, [[np.nan, 0, 0]]]))), "left out 1 point with a coord"),
    "nan.xyz": ("nan nan nan\n" + text(POINTS), "left out 1 point with a coord"),
    "coarse.xyz": (text(np.round(POINTS * 40) / 2 + 5e6), "single precision, in steps of 0.5"),
    "twice.xyz": (text(np.vstack([POINTS, POINTS[:2]])), "left out 2 duplicate points"),
    "normals.obj": (
        "".join(f"v {line}\n" for line in text(POINTS).splitlines()) + "vn 0 0 1\n",
        "left out 1 normal, as",
    ),
}


@over("name", WARNED)
def test_what_is_left_out_is_said(tmp_path, name):
    content, message = WARNED[name]
    with pytest.warns(MeshfitWarning, match=message):
        assert load_target(written(tmp_path, name, content)).num_verts == 30


def test_a_cloud_with_stray_faces_is_a_cloud(tmp_path):
    points = RNG.normal(size=(100, 3))
    rows = "".join(f"v {line}\n" for line in text(points).splitlines())
    path = written(tmp_path, "stray.obj", rows + "f 1 2 3\nf 2 3 4\n")
    with pytest.warns(MeshfitWarning, match=r"read as points without its faces, as its faces use only 4 of its 100 v"):
        cloud = load_target(path)
    assert isinstance(cloud, PointCloud)
    assert np.allclose(cloud.verts, points)


ONE = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(f"property float {axis}\n" for axis in "xyz")
ONE += "end_header\n1 2 3\n"
REFUSED = {
    "three.xyz": (text(POINTS[:3]), "points: expected 4 or more, got 3"),
    "one.ply": (ONE, "expected 4 or more, got 1"),
    "commas.csv": (
        "x,y,z\n" + text(POINTS).replace(".", ",").replace(" ", ","),
        "expected 3 columns, as line 1 names, got 6",
    ),
    "same.xyz": (text(np.repeat(POINTS[:1], 9, axis=0)), "expected 4 or more, got 1"),
    "line.xyz": (text(np.outer(np.arange(9.0), [1, 2, 3])), "its 9 points lie on a line"),
    "empty.xyz": ("", "the file is empty"),
    "comments.xyz": ("# x y z\n", "no points in it"),
}


@over("name", REFUSED)
@pytest.mark.filterwarnings("ignore::meshfit.errors.MeshfitWarning")
def test_what_is_no_cloud_is_refused_in_a_line(tmp_path, name):
    content, message = REFUSED[name]
    with pytest.raises(MeshError) as caught:
        load_target(written(tmp_path, name, content))
    assert str(caught.value).startswith(f"{tmp_path / name}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_where_a_mesh_is_expected_points_are_refused_with_the_remedy(tmp_path):
    path = written(tmp_path, "a.xyz", text(POINTS))
    with pytest.raises(NoFacesError, match=r"meshfit fit POINTS -o surface\.ply"):
        meshfit.as_mesh(path)
    with pytest.raises(NoFacesError, match="a cloud of 30 points"):
        require_mesh(as_mesh_or_points(path), "a.xyz")
    save_mesh(octahedron(), tmp_path / "a.ply")
    assert isinstance(as_mesh_or_points(tmp_path / "a.ply"), Mesh)
    assert isinstance(as_mesh_or_points("cube"), Mesh)


def test_points_without_a_normal_follow_those_that_have_one():
    sphere = icosphere(4).verts
    normals = np.where(np.arange(len(sphere))[:, None] % 7 == 0, -sphere, 0.0)
    cloud = PointCloud(sphere, normals)
    found = oriented_cloud(cloud)
    assert np.array_equal(found.normals[::7], cloud.normals[::7])
    assert (np.einsum("nk,nk->n", found.normals, sphere) < -0.9).all()


@over("sensor", [(0, 0, 9.0), (0.0, 0, 0.25), (0, 0, 0.0)])
def test_the_viewpoint_of_a_file_is_its_sensor_unless_it_is_the_default(tmp_path, sensor):
    sphere = icosphere(4).verts
    seen = sphere[sphere[:, 2] > 0.3]
    content = pcd(seen, "x y z")[1].replace(b"VIEWPOINT 0 0 0", f"VIEWPOINT {' '.join(map(str, sensor))}".encode())
    cloud = load_target(written(tmp_path, "a.pcd", content))
    assert cloud.sensor == (sensor if any(sensor) else None)
    side = -1 if sensor[2] == 0.25 else 1
    frame = meshfit.frame_of(cloud)
    again = read_written_points(MeshFile("a", ".ply", encode_point_cloud(cloud)))
    for other in (cloud, frame.normalise(cloud), frame.restore(frame.normalise(cloud)), again):
        assert (side * np.einsum("nk,nk->n", oriented_cloud(other).normals, seen) > 0.9).all()
    # A sensor that is given goes before that of the file.
    other = (0, 0, -9 * side)
    assert np.array_equal(oriented_cloud(cloud, other).normals, oriented_cloud(PointCloud(seen), other).normals)


def test_a_viewpoint_that_does_not_see_the_points_is_left_out(tmp_path):
    content = pcd(icosphere(4).verts, "x y z")[1].replace(b"VIEWPOINT 0 0 0", b"VIEWPOINT 0 0 9")
    with pytest.warns(MeshfitWarning, match=r"its viewpoint \(0.0, 0.0, 9.0\) does not see \d+ % of its points"):
        cloud = load_target(written(tmp_path, "a.pcd", content))
    assert cloud.sensor is None


def test_a_sensor_tells_the_side():
    sphere = icosphere(4).verts
    seen = sphere[sphere[:, 2] > 0.3]
    for sensor, side in (((0, 0, 9), 1), ((0, 0, 0), -1)):
        assert (side * np.einsum("nk,nk->n", oriented_cloud(PointCloud(seen), sensor).normals, seen) > 0.9).all()
