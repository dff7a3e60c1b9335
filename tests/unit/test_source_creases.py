"""Creases and alphas of the source: in configs, in identities, on their way to workers, and refused before a run."""

import numpy as np
import pytest

from meshfit.config.loading import load_experiment
from meshfit.config.source_settings import SourceSettings
from meshfit.errors import ConfigError, MeshError, MeshfitError, SchemeError
from meshfit.experiment import input_checks
from meshfit.experiment.plan import plan
from meshfit.experiment.running.batch_runner import run_batch
from meshfit.experiment.running.worker import pack_inputs, unpack_inputs
from meshfit.experiment.source import build_source, relocated
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.trial_status import TrialStatus
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, octahedron
from meshfit.mesh.topology import Topology
from meshfit.report.tables.grouping import shared_settings
from meshfit.report.tables.heads import _creases_and_alphas
from meshfit.settings import build
from meshfit.subdivision.creases import Creases, creases_by_angle
from meshfit.subdivision.refine import subdivide
from tests.loops import over
from tests.small import ellipsoid, experiment

ALPHAS = [0.0, 1.0, 0.25, 0.5, 0.125, 1.0]


def settings(**changes) -> SourceSettings:
    return build(SourceSettings, {"levels": 2, **changes})


def only(folder, **changes):
    (trial,) = plan([experiment(folder, **changes)])
    return trial


@pytest.fixture
def edges(tmp_path):
    path = tmp_path / "edges.txt"
    path.write_text("0 2\n0 4 1.5\n5\n")
    return path


@pytest.fixture
def alphas(tmp_path):
    path = tmp_path / "alphas.txt"
    path.write_text("\n".join(map(str, ALPHAS)))
    return path


def test_creases_by_angle_with_a_sharpness_or_for_ever():
    for sharpness in (None, 1.5):
        mesh = build_source(settings(mesh="cube", creases={"angle": 45, "sharpness": sharpness}), "loop")
        creases = creases_by_angle(cube(), 45, np.inf if sharpness is None else sharpness)
        np.testing.assert_allclose(mesh.verts, subdivide(cube(), "loop", 2, creases=creases).verts, atol=1e-14)


def test_creases_and_alphas_from_files(edges, alphas):
    solid = octahedron()
    given = {"creases": {"file": str(edges), "sharpness": 0.5}, "alpha": {"file": str(alphas)}}
    mesh = build_source(settings(mesh="octahedron", **given), "interp-loop:weights=warren")
    creases = Creases.of(Topology.of(solid), [(0, 2), (0, 4)], [0.5, 1.5], [5])
    expected = subdivide(solid, "interp-loop:weights=warren", 2, creases=creases, alpha=np.array(ALPHAS))
    np.testing.assert_allclose(mesh.verts, expected.verts, atol=1e-14)


def test_the_verts_of_a_file_are_counted_as_it_has_them(tmp_path, edges):
    solid = octahedron()
    soup = Mesh(solid.verts[solid.faces].reshape(-1, 3), np.arange(24).reshape(8, 3))
    save_mesh(soup, tmp_path / "soup.obj")
    edges.write_text("0 1\n")
    mesh = build_source(settings(mesh=str(tmp_path / "soup.obj"), creases={"file": str(edges)}), "loop")
    expected = subdivide(solid, "loop", 2, creases=Creases.of(Topology.of(solid), solid.faces[:1, :2]))
    distance = np.linalg.norm(mesh.verts[:, None] - expected.verts[None], axis=2).min(axis=1)
    assert distance.max() < 1e-14


def test_an_alpha_from_a_property_of_the_control_mesh(tmp_path):
    solid = octahedron()
    save_mesh(solid, tmp_path / "own.ply", normals=np.tile(np.array(ALPHAS)[:, None], 3))
    mesh = build_source(settings(mesh=str(tmp_path / "own.ply"), alpha={"attribute": "nx"}), "interp-loop")
    np.testing.assert_allclose(mesh.verts, subdivide(solid, "interp-loop", 2, alpha=np.array(ALPHAS)).verts, atol=1e-14)


def test_projection_goes_with_creases():
    given = {"mesh": "cube", "project": "sphere", "creases": {"angle": 45}}
    mesh, plain = (build_source(settings(**one), "loop") for one in (given, given | {"creases": None}))
    np.testing.assert_allclose(np.linalg.norm(mesh.verts, axis=1), 1, atol=1e-14)
    assert np.abs(mesh.verts - plain.verts).max() > 0.01


REFUSED = [
    ({"creases": {"angle": 30}}, "sqrt3", SchemeError, "source.creases: sqrt3 takes no creases; loop, interp-loop"),
    ({"creases": {"angle": 30}, "levels": 0}, "butterfly", SchemeError, "source.creases: butterfly takes no creases"),
    ({"creases": {"file": "gone.txt"}}, "loop", MeshError, "source.creases: gone.txt: no such file"),
    ({"alpha": {"file": "gone.txt"}}, "interp-loop", MeshError, "source.alpha: gone.txt: no such file"),
    ({"alpha": {"file": "gone.txt"}}, "loop", SchemeError, "source.alpha: loop: this scheme has no parameter alpha"),
    ({"alpha": {"attribute": "a"}}, "interp-loop", MeshError, "source.alpha: attribute: octahedron is built in"),
    ({"alpha": {"attribute": "a"}, "mesh": "bunny"}, "interp-loop", MeshError, "can be read from a PLY file only"),
    ({"alpha": {"attribute": "a"}, "mesh": "bone"}, "interp-loop", MeshError, "its vertices have no property 'a'"),
    ({"alpha": {"file": "a"}, "mesh": "bone", "decimate": 100}, "interp-loop", ConfigError, "source.decimate replaces"),
    ({"creases": {"file": "a"}, "mesh": "bone", "decimate": 100}, "loop", ConfigError, "source.decimate replaces"),
]


@over(("given", "scheme", "kind", "message"), REFUSED)
def test_what_is_refused(given, scheme, kind, message):
    with pytest.raises(kind, match=message.replace(".", r"\.")):
        build_source(settings(**({"mesh": "octahedron"} | given)), scheme)


def test_alphas_out_of_range_and_of_another_count(alphas):
    given = settings(mesh="octahedron", alpha={"file": str(alphas)})
    alphas.write_text("0\n1\n2\n0\n0\n0\n")
    with pytest.raises(
        MeshError, match=r"source\.alpha: .*alphas\.txt: vertex 2: expected a number from 0 to 1, got 2"
    ):
        build_source(given, "interp-loop")
    alphas.write_text("0\n")
    with pytest.raises(MeshError, match=r"expected one number for each of the 6 vertices of the mesh file, got 1"):
        build_source(given, "interp-loop")


def test_a_decimated_mesh_can_have_creases_by_angle():
    mesh = build_source(settings(mesh="bone", decimate=200, levels=1, creases={"angle": 40}), "loop")
    plain = build_source(settings(mesh="bone", decimate=200, levels=1), "loop")
    assert np.array_equal(mesh.faces, plain.faces)
    assert np.abs(mesh.verts - plain.verts).max() > 1e-3


def test_a_scheme_that_takes_no_creases_is_refused_before_the_run(tmp_path):
    with pytest.raises(SchemeError, match=r"source\.creases: modified-butterfly takes no creases"):
        plan([experiment(tmp_path, schemes=["loop", "modified-butterfly"], source={"creases": {"angle": 30}})])


@pytest.mark.parametrize("key", [{"creases": {"angle": 30}}, {"alpha": {"attribute": "a"}}])
def test_a_fit_with_levels_of_its_own_takes_neither(tmp_path, key):
    (name,) = key
    with pytest.raises(ConfigError, match=rf"source\.{name}: gauss-newton fits without {name}; set fit\.method: "):
        experiment(tmp_path, source=key, fit={"method": "gauss-newton"})


def test_identities_are_what_they_were_where_there_are_none(tmp_path):
    """No such key enters, so that results from before there were any stay complete."""
    trial = only(tmp_path)
    assert not {"creases", "alpha"} & trial.plain_settings["source"].keys()
    assert only(tmp_path, source={"creases": None, "alpha": None}).identity == trial.identity


def test_creases_and_the_content_of_their_file_enter_the_identity_and_its_place_does_not(tmp_path, edges):
    given = [None, {"angle": 30}, {"angle": 31}, {"angle": 30, "sharpness": 2}, {"file": str(edges)}]
    seen = [only(tmp_path, source={"creases": creases}).identity for creases in given]
    (tmp_path / "elsewhere").mkdir()
    moved = tmp_path / "elsewhere" / "edges.txt"
    moved.write_text(edges.read_text())
    assert only(tmp_path, source={"creases": {"file": str(moved)}}).identity == seen[-1]
    edges.write_text("0 2\n")
    seen.append(only(tmp_path, source={"creases": {"file": str(edges)}, "levels": 1}).identity)
    assert len(set(seen)) == len(seen)


def test_paths_in_a_config_lie_relative_to_it(tmp_path, edges, alphas, monkeypatch):
    ellipsoid(tmp_path)
    (tmp_path / "c.yaml").write_text(
        "targets: [ellipsoid.ply]\nschemes: [interp-loop]\n"
        "source: {mesh: octahedron, creases: {file: edges.txt}, alpha: {file: alphas.txt}}\n"
        "sweep: {source.creases.file: [edges.txt]}\n"
    )
    monkeypatch.chdir("/")
    loaded = load_experiment(str(tmp_path / "c.yaml"))
    assert loaded.settings.source.creases.file == str(edges.resolve())
    assert loaded.settings.sweep == {"source.creases.file": [str(edges.resolve())]}
    (trial,) = plan([loaded])
    assert trial.files == {
        "target": str(tmp_path / "ellipsoid.ply"),
        "creases": str(edges.resolve()),
        "alpha": str(alphas.resolve()),
    }
    assert [role for role, _ in trial.inputs] == ["target", "creases", "alpha"]


def test_a_key_that_is_wrong_is_named_with_its_line(tmp_path):
    (tmp_path / "c.yaml").write_text("source:\n  creases:\n    angle: 500\n")
    with pytest.raises(ConfigError, match=r"line 3: source\.creases\.angle: expected a number of 180 or less, got 500"):
        load_experiment(str(tmp_path / "c.yaml"))


def given_files(edges, alphas):
    source = {"mesh": "octahedron", "levels": 2, "creases": {"file": str(edges)}, "alpha": {"file": str(alphas)}}
    return {"schemes": ["interp-loop"], "source": source}


def test_a_trial_runs_here_and_where_its_files_were_sent(tmp_path, edges, alphas):
    (trial,) = plan([experiment(tmp_path, **given_files(edges, alphas))])
    here, there = RunDirectory(tmp_path / "here"), RunDirectory(tmp_path / "there")
    files = pack_inputs(trial, here)
    assert {"inputs/creases/edges.txt", "inputs/alpha/alphas.txt"} <= files.keys()
    (outcome,) = run_batch([trial], here, lambda *_: None)
    assert outcome.status is TrialStatus.COMPLETE
    for path in (edges, alphas):
        path.unlink()
    opened = unpack_inputs(trial, files, there, tmp_path / "inputs")
    (outcome,) = run_batch([opened], there, lambda *_: None)
    assert outcome.status is TrialStatus.COMPLETE, outcome.message
    for name in ("source.ply", "result.ply", "config.yaml"):
        assert (here.folder(trial) / name).read_bytes() == (there.folder(trial) / name).read_bytes()
    source = load_mesh(here.folder(trial) / "source.ply")
    plain = build_source(settings(mesh="octahedron"), "interp-loop")
    assert np.abs(source.verts - plain.verts).max() > 0.01


def test_a_file_that_changed_after_planning_fails_the_trial(tmp_path, edges, alphas):
    (trial,) = plan([experiment(tmp_path, **given_files(edges, alphas))])
    alphas.write_text("\n".join(["1"] * 6))
    (outcome,) = run_batch([trial], RunDirectory(tmp_path / "runs"), lambda *_: None)
    assert outcome.status is TrialStatus.FAILED
    assert "alphas.txt: the file has changed since the run began; run the same command again" in outcome.message


def test_relocated_leaves_what_is_no_file():
    given = settings(mesh="cube", creases={"angle": 30}, alpha={"attribute": "a"})
    assert relocated(given, {"cube": "there"}.get) == given.model_copy(update={"mesh": "there"})
    with pytest.raises(MeshfitError):
        build_source(given, "loop")


TAGS = [
    ({"creases": {"angle": 40}}, ["creases above 40 degrees"]),
    ({"creases": {"angle": 40, "sharpness": 1.5}}, ["creases above 40 degrees of sharpness 1.5"]),
    ({"creases": {"file": "/there/edges.txt"}}, ["creases of edges"]),
    ({"alpha": {"file": "/there/alphas.txt"}}, ["alpha of each vertex from alphas"]),
    (
        {"alpha": {"attribute": "stay"}, "creases": {"angle": 1}},
        ["creases above 1 degrees", "alpha of each vertex from stay"],
    ),
    ({}, []),
]


@pytest.mark.parametrize(("given", "text"), TAGS)
def test_tables_tell_what_a_source_is_tagged_with(given, text):
    plain = {"source": settings(**given).model_dump(mode="json")}
    assert list(_creases_and_alphas(shared_settings({"settings": plain, "schema_version": 2}))) == text


def test_results_share_a_table_by_what_is_in_their_files_not_by_where_these_lie(tmp_path, edges, alphas):
    def shared(creases):
        trial = only(tmp_path, **given_files(creases, alphas))
        inputs = dict(trial.inputs)
        return shared_settings({"settings": trial.plain_settings, "schema_version": 2, "inputs": inputs}), inputs

    (tmp_path / "elsewhere").mkdir()
    moved = tmp_path / "elsewhere" / "edges.txt"
    moved.write_text(edges.read_text())
    (here, inputs), (there, _) = shared(edges), shared(moved)
    assert here == there
    assert here["source.creases.file"] == "edges"
    assert here["source.creases.sha256"] == inputs["creases"][:12]
    moved.write_text("0 3\n")
    input_checks._check_source.cache_clear()
    assert shared(moved)[0] != here
