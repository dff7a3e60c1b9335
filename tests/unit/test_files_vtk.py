# ruff: noqa: E501  one fault a line
"""VTK files, legacy and XML: hand-made ones, and all encodings that VTK itself writes."""

import warnings
from itertools import product

import numpy as np
import pytest

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.io.vtk_legacy import read_vtk
from tests.loops import over

POINTS = np.array(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0], [1, 2, 0], [3, 0, 0], [4, 0, 0], [3, 1, 1]], float
)
# A quad, a pentagon that is concave, a strip of four triangles, a triangle.
QUAD, CONCAVE, STRIP, TRIANGLE = [0, 1, 3, 2], [0, 7, 3, 5, 4], [0, 1, 2, 3, 4, 5], [6, 7, 8]
STRIP_TRIANGLES = [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]]


def read(content):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        soup = read_vtk(content if isinstance(content, bytes) else content.encode())
    faces = [face.tolist() for face in np.split(soup.corners, np.cumsum(soup.sizes)[:-1])] if len(soup.sizes) else []
    return soup.verts, faces, [str(warning.message) for warning in caught]


def lists(*cells):
    return "\n".join(" ".join(map(str, [len(cell), *cell])) for cell in cells)


def legacy(body, points=POINTS, dataset="POLYDATA", version="3.0"):
    rows = "\n".join(" ".join(map(str, row)) for row in points)
    return f"# vtk DataFile Version {version}\na title\nASCII\nDATASET {dataset}\nPOINTS {len(points)} float\n{rows}\n{body}"


CELLS = f"POLYGONS 3 15\n{lists(QUAD, CONCAVE, TRIANGLE)}\nTRIANGLE_STRIPS 1 7\n{lists(STRIP)}\n"
OFFSETS = (
    "POLYGONS 4 12\nOFFSETS vtktypeint64\n0 4 9 12\nCONNECTIVITY vtktypeint64\n0 1 3 2 0 7 3 5 4 6 7 8\n"
    "TRIANGLE_STRIPS 2 6\nOFFSETS vtktypeint64\n0 6\nCONNECTIVITY vtktypeint64\n0 1 2 3 4 5\n"
)
GRID = f"CELLS 4 22\n{lists(QUAD, CONCAVE, TRIANGLE, STRIP)}\nCELL_TYPES 4\n9\n7\n5 6\n"
FIELD = "FIELD FieldData 1\nTIME 1 2 double\n0 1\n"
METADATA = "METADATA\nINFORMATION 1\nNAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 0 1\n\n"
VARIANTS = {
    "poly data": legacy(CELLS),
    "version 5": legacy(OFFSETS, version="5.1"),
    "an unstructured grid": legacy(GRID, dataset="UNSTRUCTURED_GRID"),
    "point data": legacy(CELLS + "POINT_DATA 9\nSCALARS a float 1\nLOOKUP_TABLE default\n" + "0 " * 9),
    "metadata": legacy(METADATA + CELLS + METADATA),
    "a field": legacy(CELLS).replace("POINTS", FIELD + "POINTS"),
    "windows lines": legacy(CELLS).replace("\n", "\r\n"),
    "lower case": legacy(CELLS)
    .replace("POLYDATA", "polydata")
    .replace("ASCII", "ascii")
    .replace("POLYGONS", "polygons"),
}
EXPECTED = [QUAD, CONCAVE, TRIANGLE, *STRIP_TRIANGLES]


@over("name", VARIANTS)
def test_all_ways_of_writing_legacy_files_give_the_same(name):
    verts, faces, caught = read(VARIANTS[name])
    assert np.array_equal(verts, POINTS)
    assert faces == EXPECTED
    assert not caught


def xml_array(name, values, kind="Int64"):
    return f'<DataArray type="{kind}" Name="{name}" format="ascii">{" ".join(map(str, np.ravel(values)))}</DataArray>'


def xml_cells(name, *cells, types=()):
    ends = np.cumsum([len(cell) for cell in cells])
    more = xml_array("types", types, "UInt8") if types else ""
    corners = [corner for cell in cells for corner in cell]
    return f"<{name}>{xml_array('connectivity', corners)}{xml_array('offsets', ends)}{more}</{name}>"


def xml(kind, *pieces):
    body = "".join(f"<Piece {head}>{content}</Piece>" for head, content in pieces)
    return f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="0.1"><{kind}>{body}</{kind}></VTKFile>'


XML_POINTS = f"<Points>{xml_array('Points', POINTS, 'Float64')}</Points>"
GRID_PIECE = ('NumberOfPoints="9" NumberOfCells="4"',
              XML_POINTS + xml_cells("Cells", QUAD, CONCAVE, TRIANGLE, STRIP, types=(9, 7, 5, 6)))  # fmt: skip
POLY_PIECE = ('NumberOfPoints="9" NumberOfPolys="3" NumberOfStrips="1"',
              XML_POINTS + xml_cells("Polys", QUAD, CONCAVE, TRIANGLE) + xml_cells("Strips", STRIP))  # fmt: skip


def test_xml_files_of_text():
    for content in (xml("UnstructuredGrid", GRID_PIECE), xml("PolyData", POLY_PIECE)):
        verts, faces, caught = read(content)
        assert np.array_equal(verts, POINTS)
        assert faces == EXPECTED
        assert not caught


def test_pieces_are_put_together():
    verts, faces, _ = read(xml("UnstructuredGrid", GRID_PIECE, GRID_PIECE))
    assert len(verts) == 18
    assert sorted(faces) == sorted(EXPECTED + [[corner + 9 for corner in face] for face in EXPECTED])


def vtk_data():
    """Return poly data and an unstructured grid of VTK with the same cells."""
    core, data = (pytest.importorskip(f"vtkmodules.{name}") for name in ("vtkCommonCore", "vtkCommonDataModel"))
    points = core.vtkPoints()
    points.SetDataTypeToDouble()
    for point in POINTS:
        points.InsertNextPoint(*point)

    def cells(*rows):
        array = data.vtkCellArray()
        for row in rows:
            array.InsertNextCell(len(row), row)
        return array

    poly, grid = data.vtkPolyData(), data.vtkUnstructuredGrid()
    poly.SetPoints(points)
    poly.SetPolys(cells(QUAD, CONCAVE, TRIANGLE))
    poly.SetStrips(cells(STRIP))
    values = core.vtkDoubleArray()
    values.SetName("values")
    values.SetNumberOfTuples(9)
    values.Fill(0.5)
    poly.GetPointData().SetScalars(values)
    grid.SetPoints(points)
    for kind, row in ((9, QUAD), (7, CONCAVE), (5, TRIANGLE), (6, STRIP)):
        grid.InsertNextCell(kind, len(row), row)
    return {"PolyData": poly, "UnstructuredGrid": grid}


def vtk_writers(name):
    """Yield the writers of VTK, set to each of their encodings."""
    legacy_io, xml_io = (pytest.importorskip(f"vtkmodules.vtkIO{kind}") for kind in ("Legacy", "XML"))
    for version, file_type in product((42, 51), (1, 2)):
        writer = getattr(legacy_io, f"vtk{name}Writer")()
        writer.SetFileVersion(version)
        writer.SetFileType(file_type)
        yield writer
    for mode, encode, compressor, header in product(
        ("Ascii", "Binary", "Appended"), (False, True), (0, 1, 3), (32, 64)
    ):
        writer = getattr(xml_io, f"vtkXML{name}Writer")()
        getattr(writer, f"SetDataModeTo{mode}")()
        writer.SetEncodeAppendedData(encode)
        writer.SetCompressorType(compressor)
        writer.SetBlockSize(64)
        getattr(writer, f"SetHeaderTypeToUInt{header}")()
        yield writer


def test_every_encoding_that_vtk_writes(tmp_path):
    for name, data in vtk_data().items():
        for writer in vtk_writers(name):
            writer.SetInputData(data)
            writer.SetFileName(str(tmp_path / "a.vtk"))
            writer.Write()
            verts, faces, _ = read((tmp_path / "a.vtk").read_bytes())
            assert np.array_equal(verts, POINTS), str(writer)
            assert faces == EXPECTED, str(writer)


def test_a_surface_beside_solids_points_and_lines_is_read_with_a_warning():
    grid = f"CELLS 4 17\n{lists([0, 1, 2, 8], TRIANGLE, [0, 1], QUAD)}\nCELL_TYPES 4\n10 5 3 8\n"
    _, faces, caught = read(legacy(grid, dataset="UNSTRUCTURED_GRID"))
    assert faces == [TRIANGLE, [0, 1, 2, 3]]
    assert caught == ["passed over 1 tetrahedra, 1 points and lines"]


def test_points_and_lines_alone_are_a_cloud(tmp_path):
    (tmp_path / "a.vtk").write_text(legacy("LINES 1 3\n2 0 1\n"))
    with pytest.raises(MeshError, match="a cloud of 9 points and no faces"):
        load_mesh(tmp_path / "a.vtk")


@over("name", ["a.vtk", "a.vtp", "a.vtu"])
def test_files_by_their_suffix(tmp_path, name):
    kind = {"a.vtp": ("PolyData", POLY_PIECE), "a.vtu": ("UnstructuredGrid", GRID_PIECE)}.get(name)
    (tmp_path / name).write_text(xml(*kind) if kind else legacy(CELLS))
    with pytest.warns(MeshfitWarning):
        assert load_mesh(tmp_path / name).num_verts > 0


def grid_of(kind, *cells):
    total = sum(len(cell) + 1 for cell in cells)
    types = f"{kind} " * len(cells)
    return legacy(
        f"CELLS {len(cells)} {total}\n{lists(*cells)}\nCELL_TYPES {len(cells)}\n{types}\n", dataset="UNSTRUCTURED_GRID"
    )


FAULTS = {
    "tetrahedra": (grid_of(10, [0, 1, 2, 8], [0, 1, 3, 8]), "a volume mesh of 2 tetrahedra; expected a surface: extract it"),
    "quadratic": (grid_of(22, [0, 1, 2, 3, 4, 5]), "1 quadratic triangles, which are not supported"),
    "unknown type": (grid_of(99, [0, 1, 2]), "cells of type 99, which is not supported"),
    "corners": (grid_of(5, [0, 1, 2, 3]), "surface cell 0: expected 3 corners, got 4"),
    "two corners": (legacy("POLYGONS 1 3\n2 0 1\n"), "surface cell 0: expected 3 or more corners, got 2"),
    "range": (legacy("POLYGONS 2 8\n3 0 1 2\n3 0 1 9\n"), "cell 1 names point 9, but points are numbered 0 to 8"),
    "negative": (legacy("POLYGONS 1 4\n3 0 1 -1\n"), "cell 0 names point -1"),
    "counts": (legacy("POLYGONS 2 8\n4 0 1 2 3\n3 0 1 2\n"), "POLYGONS: announces 8 numbers, but its cells take 9"),
    "short": (legacy("POLYGONS 3 8\n3 0 1 2\n3 0 1 2\n"), "POLYGONS: announces 3 cells, but its numbers hold 2"),
    "cut": (legacy("POLYGONS 2 8\n3 0 1 2\n3 0"), "POLYGONS: cut short: announces 8 numbers, but 6 are left"),
    "giant": (legacy("POLYGONS 2 8000000000\n3 0 1 2\n"), "POLYGONS: cut short: announces 8000000000 numbers, more than"),
    "word": (legacy("POLYGONS 1 4\n3 0 1 x\n"), "POLYGONS: expected 4 numbers, got a word that is none"),
    "section": (legacy("PILYGONS 1 4\n3 0 1 2\n"), "expected a section such as POINTS or POLYGONS, got 'PILYGONS'"),
    "structured": (legacy("", dataset="STRUCTURED_GRID"), "expected a data set POLYDATA or UNSTRUCTURED_GRID, got 'STRUCT"),
    "offsets": (legacy(OFFSETS.replace("0 4 9 12", "0 4 9 13"), version="5.1"), "POLYGONS: expected offsets that rise from 0"),
    "no types": (legacy("CELLS 1 4\n3 0 1 2\n", dataset="UNSTRUCTURED_GRID"), "CELLS without CELL_TYPES; cut short"),
    "type": (legacy(CELLS).replace("float", "quad"), "POINTS: expected a type such as float, got 'quad'"),
    "form": (legacy(CELLS).replace("ASCII", "HEX"), "expected '# vtk DataFile', a title, and 'ASCII' or 'BINARY'"),
    "binary": (legacy(CELLS).replace("ASCII", "BINARY").replace("POINTS 9", "POINTS 999"), "POINTS: cut short: announces 2997"),
    "xml": (xml("PolyData", POLY_PIECE)[:-5], "its XML is damaged or cut short"),
    "root": ("<VTKFiles/>", "expected XML with the root 'VTKFile', got 'VTKFiles'"),
    "image": ('<VTKFile type="ImageData"><ImageData/></VTKFile>', "expected poly data or an unstructured grid, got 'ImageData'"),
    "xml offsets": (xml("PolyData", (POLY_PIECE[0], POLY_PIECE[1].replace("4 9 12", "4 9 11"))), "expected offsets of Polys"),
    "xml points": (xml("PolyData", (POLY_PIECE[0].replace("9", "8"), POLY_PIECE[1])), "expected 8 points, got 27 coordinates"),
    "xml count": (xml("PolyData", (POLY_PIECE[0].replace("3", "4"), POLY_PIECE[1])), "NumberOfPolys is 4, but 3 are there"),
    "xml word": (xml("PolyData", POLY_PIECE).replace(">4 9 12", ">4 nine 12"), "offsets of Polys: expected integers, got 'nine'"),
    "lz4": (xml("PolyData", POLY_PIECE).replace('"0.1"', '"0.1" compressor="vtkLZ4DataCompressor"'), "compress it with zlib"),
    "base64": (xml("PolyData", POLY_PIECE).replace('"ascii"', '"binary"', 1), "its base64 is damaged"),
}  # fmt: skip


def test_the_fault_is_named():
    for name, (content, expected) in FAULTS.items():
        with pytest.raises(MeshError) as caught:
            pytest.fail(f"{name} gives {read(content)[1]}")
        assert expected in str(caught.value), name
        assert "\n" not in str(caught.value)
