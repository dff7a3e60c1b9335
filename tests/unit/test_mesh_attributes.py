"""Attributes of vertices, faces and corners follow them through cleaning and triangulation."""

import io
import warnings
import zipfile

import numpy as np

from meshfit.errors import MeshfitWarning
from meshfit.mesh.attributes import Attributes, Material
from meshfit.mesh.cleaning import clean
from meshfit.mesh.cleaning_options import CleaningOptions
from meshfit.mesh.io.files import encode_mesh, load_mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup
from meshfit.mesh.solids import icosahedron, octahedron, quad_cube
from tests import scenes
from tests.loops import over
from tests.quads import mixed, prism
from tests.shapes import torus


def damaged(mesh, seed):
    """A mesh with a repeated corner, a duplicate, a degenerate and a bow-tie face, in vertices that no two share."""
    rng = np.random.default_rng(seed)
    mesh = PolygonMesh.of(mesh)
    rows = [mesh.corners[start : start + size].tolist() for start, size in zip(mesh.starts, mesh.sizes, strict=True)]
    rows[1] = [*rows[1][:2], rows[1][1], *rows[1][2:]]
    rows += [rows[2][1:] + rows[2][:1], [rows[3][0], rows[3][1], rows[3][1]]]
    rows = [rows[at] for at in rng.permutation(len(rows))]
    if seed % 2:  # every face has vertices of its own
        corners = np.concatenate(rows)
        order = rng.permutation(len(corners))
        verts = np.empty((len(corners), 3))
        verts[order] = mesh.verts[corners]
        ends = np.cumsum([len(row) for row in rows])
        rows = [part.tolist() for part in np.split(order, ends[:-1])]
        return verts, rows
    return mesh.verts, rows


@over(
    ("mesh", "seed", "triangles"),
    [
        (mesh, seed, triangles)
        for mesh in (icosahedron(), quad_cube(), torus(), prism(9), mixed())
        for seed in (0, 1)
        for triangles in (False, True)
    ],
)
def test_each_element_keeps_the_row_of_the_one_it_came_from(mesh, seed, triangles):
    verts, rows = damaged(mesh, seed)
    plain = PolygonSoup.of_rows(verts.tolist(), rows)
    face = np.repeat(np.arange(len(rows)), plain.sizes)
    attributes = Attributes(
        vertex={"place": plain.verts, "number": np.arange(len(plain.verts))},
        face={"row": np.arange(len(rows), dtype=np.uint16)},
        corner={"place": plain.verts[plain.corners].astype("f4"), "face": face},
        materials=(Material("red"),),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)
        options = CleaningOptions(repair="split") if seed else CleaningOptions()
        bare, _ = clean(plain, "it", options, triangles=triangles)
        found, _ = clean(plain._replace(attributes=attributes), "it", options, triangles=triangles)
    assert (found.verts.tobytes(), found.corners.tobytes()) == (bare.verts.tobytes(), bare.corners.tobytes())
    carried = found.attributes
    of_corner = np.repeat(np.arange(found.num_faces), found.sizes)
    assert np.array_equal(carried.vertex["place"], found.verts)
    assert np.array_equal(carried.corner["place"], found.verts[found.corners].astype("f4"))
    assert np.array_equal(carried.corner["face"], carried.face["row"][of_corner])
    assert carried.face["row"].dtype == np.uint16
    assert carried.materials == attributes.materials
    numbers = carried.corner["number"] if seed else carried.vertex["number"][found.corners]  # welded ones differ
    assert np.array_equal(plain.verts[numbers], found.verts[found.corners])
    assert all(number in rows[row] for number, row in zip(numbers, carried.corner["face"], strict=True))


def test_texture_coordinates_go_to_corners_and_the_first_skin_weights_stay():
    corners = np.arange(6)
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    numbers = np.arange(6.0)[:, None]
    attributes = Attributes(
        vertex={"uv": np.hstack([numbers, numbers]), "joints": numbers, "nan": 0 * numbers + np.nan}
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)
        mesh, _ = clean(PolygonSoup(square, corners, np.array([3, 3]), attributes), "it")
    assert mesh.num_verts == 4
    assert mesh.attributes.corner.keys() == {"uv"}
    assert np.array_equal(mesh.attributes.corner["uv"][:, 0], np.arange(6))
    assert mesh.attributes.vertex["joints"][:, 0].tolist() == [0, 1, 2, 5]
    assert np.isnan(mesh.attributes.vertex["nan"]).all()


def test_attributes_that_a_format_has_but_none_reads_are_named_in_one_line(tmp_path):
    faces = b"3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n"
    coloured = faces.replace(b"\n", b" 0.5 0 1\n")
    off = b"OFF\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
    vert_colours = b"COFF\n4 4 6\n" + b"".join(b"%b 9 9 9 255\n" % line for line in off.splitlines()[2:])
    rows = "".join(
        f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))
    )
    points = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)))
    package = io.BytesIO()
    with zipfile.ZipFile(package, "w") as archive:
        archive.writestr(
            "3D/3dmodel.model",
            f'<model xmlns:m="a"><resources><m:colorgroup id="2"/><basematerials id="3"/><object id="1"><mesh>'
            f"<vertices>{points}</vertices><triangles>{rows}</triangles></mesh></object></resources></model>",
        )
    stl = encode_mesh(octahedron(), ".stl")
    texts = {
        "a.off": (off + coloured, "colours of faces are not read from OFF"),
        "b.off": (vert_colours + faces, "colours are not read from OFF"),
        "plain.off": (off + faces, None),
        "plain.stl": (stl, None),
        "a.stl": (b"COLOR=".ljust(80, b"\1") + stl[80:], "colours are not read from STL"),
        "a.3mf": (package.getvalue(), "materials, colours are not read from 3MF"),
        "a.dae": (scenes.DAE.replace(b'semantic="POSITION"', b'semantic="POSITION" name="semantic=\'TEXCOORD\'"'),
                  "texture coordinates are not read from DAE"),
        "a.vtk": (b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\n"
                  b"POLYGONS 4 16\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\nPOINT_DATA 4\nSCALARS a float 1\n"
                  b"LOOKUP_TABLE default\n0 0 0 0\n", "data of points and cells are not read from VTK"),
    }  # fmt: skip
    for name, (content, expected) in texts.items():
        (tmp_path / name).write_bytes(content)
        for attributes in (True, False):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                load_mesh(tmp_path / name, attributes=attributes)
            found = [str(warning.message) for warning in caught if "are not read" in str(warning.message)]
            assert found == ([f"{tmp_path / name}: {expected}"] if attributes and expected else [])
