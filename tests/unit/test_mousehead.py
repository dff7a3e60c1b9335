"""The mousehead target has the promised properties, and its generator checks them."""

import hashlib
import importlib.util

import numpy as np
import pytest

from meshfit.mesh.geometry import bounding_box, corner_angles
from meshfit.mesh.manifold import euler_number, num_components, require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import self_intersecting_faces
from meshfit.mesh.targets import NAMED_TARGETS, load_target
from meshfit.mesh.topology import Topology
from meshfit.paths import bundled_folder
from tests.loops import over


@pytest.fixture(scope="module")
def mesh():
    return load_target("mousehead")


@pytest.fixture(scope="module")
def generator():
    spec = importlib.util.spec_from_file_location("mousehead", bundled_folder("data") / "mousehead.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def as_arrays(mesh):
    return np.array(mesh.verts), np.array(mesh.faces, dtype=np.int32)


def test_the_file_is_the_one_that_table_and_sources_name():
    digest = hashlib.sha256((bundled_folder("data") / "mousehead.ply").read_bytes()).hexdigest()
    assert digest == NAMED_TARGETS["mousehead"].sha256
    assert digest in (bundled_folder("data") / "SOURCES.md").read_text(encoding="utf-8")


def test_it_is_one_closed_surface_of_genus_0(mesh):
    topology = Topology.of(mesh)
    require_manifold(topology, "this test")
    assert topology.is_watertight
    assert euler_number(topology) == 2
    assert num_components(topology) == 1


def test_it_is_turned_outwards(mesh):
    corners = mesh.verts[mesh.faces]
    assert np.linalg.det(corners).sum() / 6 > 0


def test_its_faces_are_as_many_and_as_round_as_promised(mesh):
    assert 5_000 <= mesh.num_faces <= 20_000
    assert np.degrees(corner_angles(mesh).min()) >= 25
    assert np.degrees(corner_angles(mesh).min()) == pytest.approx(36.9, abs=0.05)
    assert np.degrees(corner_angles(mesh).max()) == pytest.approx(85.7, abs=0.05)


def test_it_does_not_cut_itself(mesh):
    assert not self_intersecting_faces(mesh).any()


def test_every_vertex_lies_on_the_implicit_surface(mesh, generator):
    assert np.abs(generator.head(mesh.verts)).max() <= 1e-12


def test_midpoints_of_edges_do_not_lie_on_it_but_near(mesh, generator):
    """So that the test above could fail."""
    middle = mesh.verts[Topology.of(mesh).edges].mean(axis=1)
    distance = np.abs(generator.head(middle))
    assert distance.mean() > 1e-5
    assert distance.max() < 0.02


def test_its_size_is_as_written(mesh):
    low, high = bounding_box(mesh.verts)
    assert high - low == pytest.approx([2.03, 1.70, 1.86], abs=0.005)


def test_the_surface_is_symmetric_and_has_two_ears(mesh, generator):
    assert np.abs(generator.head(mesh.verts * [-1, 1, 1])).max() < 1e-12
    ears = mesh.verts[mesh.verts[:, 1] > 0.8]
    assert (ears[:, 0] > 0.2).any()
    assert (ears[:, 0] < -0.2).any()
    assert not (np.abs(ears[:, 0]) < 0.1).any()


def test_the_check_lets_the_mesh_through(mesh, generator):
    generator.check(*as_arrays(mesh))


def moved(verts, faces):
    verts[17] *= 1.001
    return verts, faces


BROKEN = {
    "lies on the zero set": moved,
    "is closed": lambda verts, faces: (verts, faces[1:]),
    "is oriented outward": lambda verts, faces: (verts, faces[:, ::-1]),
    "has 5,000 to 20,000 faces": lambda verts, faces: (verts, faces[:4000]),
    "uses every vertex": lambda verts, faces: (np.concatenate([verts, verts[:1]]), faces),
    "is one component": lambda verts, faces: (
        np.concatenate([verts, verts + 5.0]),
        np.concatenate([faces, faces + len(verts)]),
    ),
    "does not cut itself": lambda verts, faces: (np.where(np.arange(len(verts))[:, None] == 17, -verts, verts), faces),
    "has angles of 25.0 degrees": lambda verts, faces: (verts * [1, 1, 4], faces),
    "has Euler number 2": lambda verts, faces: (
        np.concatenate([verts, verts + 5.0]),
        np.concatenate([faces, faces + len(verts)]),
    ),
}


@pytest.mark.slow
@over("promise", BROKEN)
def test_the_check_refuses_a_broken_promise(mesh, generator, promise):
    with pytest.raises(ValueError, match="mousehead breaks the promise that it: ") as caught:
        generator.check(*BROKEN[promise](*as_arrays(mesh)))
    assert promise in str(caught.value)


@pytest.mark.slow
def test_made_anew_it_is_nearly_the_same(mesh, generator):
    points, faces = generator.remesh(*generator.cut_out())
    points = generator.relax(points, faces)
    generator.check(points, faces)
    again = Mesh(points, faces)
    assert again.num_faces == pytest.approx(mesh.num_faces, rel=0.05)
    for ours, theirs in zip(bounding_box(again.verts), bounding_box(mesh.verts), strict=True):
        assert ours == pytest.approx(theirs, abs=0.02)


def test_it_is_written_as_it_is_read(mesh, generator, tmp_path):
    generator.write_ply(tmp_path / "a.ply", *as_arrays(mesh))
    assert (tmp_path / "a.ply").read_bytes() == (bundled_folder("data") / "mousehead.ply").read_bytes()
