"""Landmark files: tables, MeshMonk's rows and the point lists of 3D Slicer, written by hand from their descriptions."""

import json
from dataclasses import replace

import numpy as np
import pytest

import meshfit
from meshfit.errors import ConfigError, MeshError, MeshfitWarning
from meshfit.mesh.landmarks import Landmark, Landmarks
from meshfit.mesh.places import Numbering, Place
from meshfit.mesh.topology import NONE

FCSV = """# Markups fiducial file version = {version}
# CoordinateSystem = {system}
# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID
0,-19.5,13.25,29.5,0,0,0,1,1,1,0,F-1,,
vtkMRMLMarkupsFiducialNode_1,-7,-76.5,17,0,0,0,1,1,1,0,"ear, left",a note,vtkMRMLModelNode4
2,81,-42,9.5,0,0,0,1,1,1,0,F-3,,,2,0
3,0,0,0,0,0,0,1,1,1,0,not placed,,,3,0
"""
POINTS = [(-19.5, 13.25, 29.5), (-7, -76.5, 17), (81, -42, 9.5)]


def load(folder, name, text):
    path = folder / name
    path.write_text(text)
    return meshfit.load_landmarks(path)


def positions(landmarks):
    return [row.place.position for row in landmarks]


def test_point_lists_of_slicer_are_in_lps_whatever_system_they_name(tmp_path):
    mirrored = [(-x, -y, z) for x, y, z in POINTS]
    for version, system, expected in (
        ("4.13", "LPS", POINTS),
        ("4.11", "RAS", mirrored),
        ("4.10", "1", POINTS),
        ("4.6", "0", mirrored),
    ):
        found = load(tmp_path, "points.fcsv", FCSV.format(version=version, system=system))
        assert found.names == ("F-1", "ear, left", "F-3")
        assert positions(found) == expected
        assert all(row.place.anatomical and row.goal is None for row in found)
    without = "\n".join(line for line in FCSV.splitlines() if "CoordinateSystem" not in line)
    assert positions(load(tmp_path, "points.fcsv", without)) == mirrored  # as early versions were


def test_markups_in_json_are_in_lps_unless_they_name_ras(tmp_path):
    points = [{"label": f"F-{number}", "position": point} for number, point in enumerate(POINTS, 1)]
    unplaced = {"label": "later", "position": None, "positionStatus": "undefined"}
    for system, sign in (("LPS", 1), ("RAS", -1), (None, 1)):
        markup = {"type": "Fiducial", "controlPoints": [*points, unplaced]}
        markup |= {} if system is None else {"coordinateSystem": system}
        found = load(tmp_path, "points.mrk.json", json.dumps({"@schema": "…", "markups": [markup]}))
        assert found.names == ("F-1", "F-2", "F-3")
        assert positions(found) == [(sign * x, sign * y, z) for x, y, z in POINTS]


def test_tables_of_control_points_name_their_axes(tmp_path):
    rows = "F-1,1,2,3,1,1,1,0,\nF-2,4,5,6,0,1,1,0,\nF-3,7,8,9,1,0,1,0,seen\n"
    states = "defined,selected,visible,locked,description"
    found = load(tmp_path, "table.csv", f"label,l,p,s,{states}\n{rows}")
    assert found.names == ("F-1", "F-3")
    assert positions(found) == [(1, 2, 3), (7, 8, 9)]
    assert positions(load(tmp_path, "table.csv", f"label,r,a,s,{states}\n{rows}")) == [(-1, -2, 3), (-7, -8, 9)]


def test_rows_without_a_header_are_positions_that_their_order_tells_apart(tmp_path):
    found = load(tmp_path, "Template.csv", "-15.5,37,14.25\n20.75,36.5,14\n2,18.125,53.5\n")
    assert found.names == ("1", "2", "3")
    assert positions(found) == [(-15.5, 37, 14.25), (20.75, 36.5, 14), (2, 18.125, 53.5)]
    named = load(tmp_path, "named.csv", "nose,1,2,3\nchin;4;5;6\n".replace(";", ","))
    assert named.names == ("nose", "chin")


def test_tables_hold_pairs_or_one_side_with_places_of_any_kind(tmp_path):
    text = (
        "# made by hand\n"
        "name,source_vertex,source_face,source_u,source_v,source_w,target_x,target_y,target_z,use\n"
        "nose,7,,,,,0,0,1,\n"
        '"ear, left",,12,0.25,0.25,0.5,1,0,0,yes\n'
        "chin,9,,,,,0,-1,0,no\n"
    )
    for separator, suffix in ((",", ".csv"), ("\t", ".tsv"), (";", ".txt")):
        found = load(tmp_path, f"pairs{suffix}", text if separator == "," else text.replace(",", separator))
        assert found.has_goals
        assert [row.place for row in found] == [
            Place(vertex=7),
            Place(face=12, weights=(0.25, 0.25, 0.5)),
            Place(vertex=9),
        ]
        assert [row.goal.position for row in found] == [(0, 0, 1), (1, 0, 0), (0, -1, 0)]
        assert found.used == (True, True, False)


def test_places_of_two_files_are_matched_by_name(tmp_path):
    (tmp_path / "head.csv").write_text("name,vertex,use\na,0,\nb,1,no\nc,2,\nd,3,\n")
    (tmp_path / "scan.csv").write_text("name,x,y,z\nd,3,0,0\nc,2,0,0\nb,1,0,0\ne,9,9,9\n")
    with pytest.warns(MeshfitWarning, match=r"a not in .*scan\.csv; e not in .*head\.csv"):
        found = meshfit.load_landmarks(tmp_path / "head.csv", tmp_path / "scan.csv")
    assert [(row.name, row.place.vertex, row.goal.position[0]) for row in found] == [
        ("b", 1, 1),
        ("c", 2, 2),
        ("d", 3, 3),
    ]
    assert found.used == (False, True, True)
    (tmp_path / "scan.csv").write_text("name,x,y,z\nd,3,0,0\nc,2,0,0\nx,1,0,0\n")
    with pytest.raises(MeshError, match=r"only 2 names occur on both sides, of 3 or more: a, b not in .*; x not in"):
        meshfit.load_landmarks(tmp_path / "head.csv", tmp_path / "scan.csv")
    with pytest.raises(MeshError, match="has pairs already"):
        found.with_goals(found)


def test_what_is_held_out_is_named_or_a_share_that_is_always_the_same():
    landmarks = meshfit.Landmarks.of(np.arange(10), np.zeros((10, 3)), [f"p{index}" for index in range(10)])
    assert landmarks.held_out(["p3"]).used == tuple(index != 3 for index in range(10))
    assert landmarks.held_out(0.3).used.count(False) == 3
    assert landmarks.held_out(0.3).used == landmarks.held_out(0.3).used
    assert not any(landmarks.held_out(1).used)
    with pytest.raises(ConfigError, match="'p33' is no landmark of landmarks: did you mean 'p3'"):
        landmarks.held_out(["p33"])


def test_files_that_cannot_be_read_are_refused_with_the_line(tmp_path):
    header = "name,source_vertex,target_x,target_y,target_z\n"
    for name, text, words in (
        ("a.csv", f"{header}a,1,2,3,x\n", "line 2: expected a finite number, got 'x'"),
        ("a.csv", f"{header}a,1,2,3,inf\n", "line 2: expected a finite number, got 'inf'"),
        ("a.csv", f"{header}\na,1.5,2,3,4\n", "line 3: source_vertex: expected a number from 0 on, got '1.5'"),
        ("a.csv", f"{header}a,,2,3,4\n", "line 2: expected one source place: .* got none"),
        ("a.csv", f"{header}a,1,2,3\n", "line 2: expected one target place: .* got incomplete"),
        ("a.csv", f"{header}a,1,2,3,4,5\n", "line 2: 6 cells, but 5 columns"),
        ("a.csv", f"{header}a,1,2,3,4\nb,1,2,3,4\na,1,2,3,4\n", "line 4: landmark 'a' is listed before, at line 2"),
        ("a.csv", "name,vertx\n", "line 1: 'vertx' is no column of a landmark file: did you mean 'vertex'"),
        ("a.csv", "name,vertex,vertex\n", "line 1: two columns 'vertex'"),
        ("a.csv", "name,source_vertex\na,1\n", "line 1: no columns target_…"),
        ("a.csv", f"x,{header}", "line 1: 'x' next to columns source_… and target_…"),
        ("a.csv", "name,use\na,no\n", "line 1: no places: expected vertex, face,u,v,w or x,y,z"),
        ("a.csv", "name,vertex,use\na,1,perhaps\n", "line 2: use: expected yes or no, got 'perhaps'"),
        ("a.csv", "name,face,u,v,w\na,1,.5,.5,.5\n", "line 2: u,v,w: expected weights .* sum of 1, got 0.5, 0.5"),
        ("a.csv", "1,2,3\n1,2\n", "line 2: expected x,y,z, got 2 cells"),
        ("a.csv", "1,2,3,4,5,6\n", "line 1: expected x,y,z, got 6 cells; other columns need a header"),
        ("a.csv", "", "no landmarks in it"),
        ("a.fcsv", "# CoordinateSystem = LSP\n", "line 1: CoordinateSystem: expected LPS or RAS, got 'LSP'"),
        ("a.fcsv", "0,1,2\n", "line 1: expected the columns id,x,y,z"),
        ("a.fcsv", "0,1,2,z,0,0,0,1,1,1,0,F-1,,\n", "line 1: expected a finite number, got 'z'"),
        ("a.mrk.json", "{", "damaged at line 1"),
        (
            "a.mrk.json",
            '{"markups": [{"controlPoints": [{"label": "F"}]}]}',
            r"markups\[0\].controlPoints\[0\]: no pos",
        ),
        (
            "a.mrk.json",
            '{"markups": [{"controlPoints": [{"position": [1, 2]}]}]}',
            "expected 3 numbers, got '2 values'",
        ),
        ("a.mrk.json", '{"markups": [{"coordinateSystem": "XYZ"}]}', "expected LPS or RAS, got 'XYZ'"),
        ("a.vtk", "x", "unknown format of landmarks; allowed: .csv"),
    ):
        with pytest.raises(MeshError, match=words) as raised:
            load(tmp_path, name, text)
        assert str(raised.value).startswith(str(tmp_path / name))
        assert "\n" not in str(raised.value)
    with pytest.raises(MeshError, match="no such file"):
        meshfit.load_landmarks(tmp_path / "missing.csv")
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe1,2")
    with pytest.raises(MeshError, match="UTF-8"):
        meshfit.load_landmarks(tmp_path / "a.csv")


def test_numbers_are_those_of_the_file_and_positions_are_taken_to_the_surface():
    ball, unused = meshfit.icosphere(2), [[9.0, 9, 9]]
    own = Numbering.of(ball)
    numbering = Numbering(
        np.concatenate([unused, ball.verts]), own.corners + 1, own.sizes, np.concatenate([[NONE], own.to_mesh])
    )
    weights = (0.5, 0.3, 0.2)
    inside = np.array(weights) @ ball.verts[ball.faces[30]]
    landmarks = Landmarks(
        (
            Landmark("1", Place(vertex=5), Place(vertex=1)),
            Landmark("2", Place(face=30, weights=weights), Place(face=30, weights=weights)),
            Landmark("3", Place(position=tuple((1.02 * ball.verts[40]).tolist())), Place(position=(1.0, 0.0, 0.0))),
        )
    )
    goals = landmarks.goal_positions(ball, numbering)
    assert np.allclose(goals, [ball.verts[0], inside, [1, 0, 0]])
    placed = landmarks.placed(ball, numbering, goals)
    assert np.allclose(placed.points(ball.verts), [ball.verts[4], inside, ball.verts[40]])
    assert np.allclose(placed.errors(ball.verts)[1], 0)
    with pytest.warns(MeshfitWarning, match=r"landmark '2' is 1 away from the source \(2\d % of its diagonal\)"):
        Landmarks.of(ball.verts[:3] * [[1], [2], [1]], goals).placed(ball, numbering, goals)
    for place, words in (
        (Place(vertex=163), "landmark 'x': no vertex 163; the source has 163, from 0"),
        (Place(face=320, weights=weights), "landmark 'x': no face 320; the source has 320, from 0"),
    ):
        with pytest.raises(MeshError, match=words):
            Landmarks((Landmark("x", place),)).placed(ball, numbering, goals[:1])
    cube = Numbering.of(meshfit.as_mesh("cube"))
    with pytest.raises(MeshError, match="face 0 has 4 corners; weights are those of a triangle"):
        cube.position(Place(face=0, weights=weights), "landmark 'x'", "source")


def test_a_list_in_other_axes_than_the_mesh_is_turned_to_it(tmp_path):
    head = meshfit.icosphere(2)
    head = head.with_verts(head.verts + np.array([5, 3, 0]))
    found = load(tmp_path, "points.csv", "r,a,s\n" + "".join(f"{x},{y},{z}\n" for x, y, z in head.verts[:4]))
    with pytest.warns(MeshfitWarning, match="x and y were negated"):
        placed = found.placed(head, Numbering.of(head), np.zeros((4, 3)))
    assert np.allclose(placed.points(head.verts), head.verts[:4])


def test_a_vertex_that_the_mesh_lacks_is_replaced_by_the_nearest_point():
    ball = meshfit.icosphere(1)
    numbering = replace(Numbering.of(ball), to_mesh=None)
    placed = meshfit.Landmarks.of([3, 4, 5], ball.verts[:3]).placed(ball, numbering, ball.verts[:3])
    assert np.allclose(placed.points(ball.verts), ball.verts[3:6])


def test_binary_files_and_endless_cells_are_refused_with_their_place(tmp_path):
    for text, message in (
        ("\0" * 500, "points.csv: not a text file in UTF-8"),
        ("name,vertex\nnose," + "1" * 200_000, "points.csv, line 2: field larger than field limit"),
    ):
        with pytest.raises(MeshError, match=message):
            load(tmp_path, "points.csv", text)
