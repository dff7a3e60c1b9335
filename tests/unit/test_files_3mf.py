# ruff: noqa: E501  one file a line
"""3MF files: objects, components, build items, units and extensions."""

import io
import warnings
import zipfile

import numpy as np
import pytest

from meshfit.errors import MeshError
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.io.threemf import read_3mf
from meshfit.mesh.mesh import Mesh
from tests.gltf import CUBE, CUBE_FACES

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
RELATIONS = (
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel" Target="/{}" Id="a"/></Relationships>'
)
VERTS = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in CUBE.tolist())
TRIANGLES = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in CUBE_FACES.tolist())
MESH = f"<mesh><vertices>{VERTS}</vertices><triangles>{TRIANGLES}</triangles></mesh>"
CUBE_OBJECT = f'<object id="1" type="model">{MESH}</object>'
DOUBLED, MIRRORED, MOVED = "2 0 0 0 1 0 0 0 1 5 0 0", "-1 0 0 0 1 0 0 0 1 9 0 0", "1 0 0 0 1 0 0 0 1 3 4 5"


def model(resources, build, attributes="", start="model"):
    return f'<?xml version="1.0"?><{start} xmlns="{CORE}" {attributes}><resources>{resources}</resources><build>{build}</build></{start}>'


def item(number=1, transform=None, more=""):
    return f'<item objectid="{number}" {more}' + (f' transform="{transform}"/>' if transform else "/>")


def component(number=1, transform=None, more=""):
    return item(number, transform, more).replace("<item", "<component")


def assembly(number, *components):
    return f'<object id="{number}"><components>{"".join(components)}</components></object>'


def archive(root, name="3D/3dmodel.model", *, relations=True, **members):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as packed:
        if relations:
            packed.writestr("_rels/.rels", RELATIONS.format(name))
        for member, text in ({name: root} | members).items():
            packed.writestr(member, text)
    return content.getvalue()


def read(content):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        soup = read_3mf(content)
    return Mesh(soup.verts, soup.corners.reshape(-1, 3)), [str(warning.message) for warning in caught]


def volume(mesh):
    corners = mesh.verts[mesh.faces]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


PART = model(CUBE_OBJECT.replace('id="1"', 'id="7"'), "", 'unit="centimeter"')
PATH = f'xmlns:p="{PRODUCTION}" p:path="/3D/part.model"'
SCENES = {
    "one": (archive(model(CUBE_OBJECT, item())), 1, 12),
    "another name": (archive(model(CUBE_OBJECT, item()), name="3D/thing.model"), 1, 12),
    "without relations": (archive(model(CUBE_OBJECT, item()), relations=False), 1, 12),
    "inches": (archive(model(CUBE_OBJECT, item(), 'unit="inch"')), 1, 12),
    "mirrored": (archive(model(CUBE_OBJECT, item(1, MIRRORED))), 1, 12),
    "two items": (archive(model(CUBE_OBJECT, item() + item(1, DOUBLED))), 3, 24),
    "components": (archive(model(CUBE_OBJECT + assembly(2, component(1, DOUBLED), component()), item(2, DOUBLED))), 6, 24),
    "mirrored twice": (archive(model(CUBE_OBJECT + assembly(2, component(1, MIRRORED)), item(2, MIRRORED))), 1, 12),
    "of components of components": (
        archive(model(CUBE_OBJECT + assembly(2, component(), component(1, MOVED)) + assembly(3, component(2), component(2, MIRRORED)), item(3))), 4, 48),
    "another part, in another unit": (
        archive(model(assembly(2, component(7, None, PATH)), item(2)), **{"3D/part.model": PART}), 1000, 12),
    "without a build": (archive(model(CUBE_OBJECT + assembly(2, component(1, DOUBLED)), "")), 2, 12),
    "materials": (archive(model(CUBE_OBJECT, item(), f'xmlns:p="{PRODUCTION}" requiredextensions="p"')), 1, 12),
}  # fmt: skip


def test_items_and_components_stand_where_their_transforms_put_them():
    for name, (content, expected, faces) in SCENES.items():
        mesh, caught = read(content)
        assert volume(mesh) == pytest.approx(expected), name
        assert mesh.num_faces == faces, name
        assert not caught


def test_a_transform_is_applied_to_rows():
    mesh, _ = read(archive(model(CUBE_OBJECT, item(1, "1 2 3 4 5 6 7 8 10 11 12 13"))))
    assert mesh.verts[1].tolist() == [12, 14, 16]


def test_objects_outside_the_build_are_counted():
    _, caught = read(archive(model(CUBE_OBJECT + CUBE_OBJECT.replace('id="1"', 'id="2"'), item())))
    assert caught == ["passed over 1 object that the build does not use"]


def test_trimesh_reads_the_same(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("networkx")
    pytest.importorskip("lxml")
    for name in ("one", "mirrored", "two items", "components"):
        (tmp_path / "a.3mf").write_bytes(SCENES[name][0])
        found = trimesh.load_scene(tmp_path / "a.3mf", process=False).to_geometry()
        mesh, _ = read(SCENES[name][0])
        assert np.allclose(sorted(found.vertices.tolist()), sorted(mesh.verts.tolist())), name


def nested(depth):
    """Return groups that hold the one before twice."""
    groups = "".join(assembly(number, component(number - 1), component(number - 1)) for number in range(2, depth))
    return archive(model(CUBE_OBJECT + groups, item(depth - 1)))


BOMB = archive(model(CUBE_OBJECT, item()) + " " * 20_000_000)
SHORT = CUBE_OBJECT.replace('v1="0"', 'v1="8"', 1)
FAULTS = {
    "no archive": (b"PK nothing", "expected a ZIP archive, got other or damaged data"),
    "no model": (archive("", name="a.txt", relations=False), "its archive has no member '3d/3dmodel.model'"),
    "cut": (archive(model(CUBE_OBJECT, item()))[:-30], "expected a ZIP archive"),
    "xml": (archive(model(CUBE_OBJECT, item())[:-9]), "3d/3dmodel.model: line 1, column"),
    "root": (archive(model("", "", start="modell")), "expected XML with the root 'model', got 'modell'"),
    "index": (archive(model(SHORT, item())), "object 1: triangle 0 is [8, 2, 3], but the object has 8 vertices"),
    "number": (archive(model(CUBE_OBJECT.replace('x="1.0"', 'x="one"', 1), item())), "x of vertex 1: expected numbers, got 'one'"),
    "lacking": (archive(model(CUBE_OBJECT.replace('z="0.0"', "", 1), item())), "vertex 0 lacks one of x, y, z"),
    "object": (archive(model(CUBE_OBJECT, item(4))), "there is no object 4, which the build or a component names"),
    "twice": (archive(model(CUBE_OBJECT * 2, item())), "two objects 1"),
    "cycle": (archive(model(assembly(1, component(2)) + assembly(2, component(1)), item())), "object 1 is a component of itself"),
    "transform": (archive(model(CUBE_OBJECT, item(1, "1 0 0"))), "item of object 1: expected a transform of 12 finite numbers"),
    "unit": (archive(model(CUBE_OBJECT, item(), 'unit="furlong"')), "expected a unit of micron, millimeter"),
    "part": (archive(model(assembly(2, component(7, None, PATH)), item(2))), "its archive has no member '3d/part.model'"),
    "beams": (archive(model(CUBE_OBJECT.replace("<triangles>", "<beamlattice/><triangles>"), item())), "object 1 is a beam lattice"),
    "extension": (archive(model(CUBE_OBJECT, item(), 'xmlns:b="http://x.y/volumetric/1" requiredextensions="b"')),
                  "requires the extension 'http://x.y/volumetric/1', which is not supported"),
    "bomb": (BOMB, "expands to 200"),
    "doubling": (nested(60), "its scene repeats the meshes far more often"),
}  # fmt: skip


def test_the_fault_is_named():
    for name, (content, expected) in FAULTS.items():
        with pytest.raises(MeshError) as caught:
            read(content)
        assert expected in str(caught.value), name
        assert "\n" not in str(caught.value)


def test_a_file_by_its_suffix(tmp_path):
    (tmp_path / "a.3mf").write_bytes(SCENES["one"][0])
    assert load_mesh(tmp_path / "a.3mf").num_faces == 12
    (tmp_path / "a.obj").write_bytes(SCENES["one"][0])
    with pytest.raises(MeshError, match=r"its content looks like 3MF, not OBJ; rename it to 'a\.3mf'"):
        load_mesh(tmp_path / "a.obj")
