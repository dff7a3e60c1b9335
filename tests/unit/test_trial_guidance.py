"""Guidance of trials: files of landmarks and of values, their part in identities, and refusals of settings."""

import numpy as np
import pytest

import meshfit
from meshfit.config.loading import load_experiment
from meshfit.errors import ConfigError, MeshfitError
from meshfit.experiment.guidance import guidance_of, read_landmarks
from meshfit.experiment.plan import plan
from meshfit.mesh.normalisation import frame_of
from meshfit.subdivision.registry import resolve

CONFIG = """
targets: [scan.ply]
target: {landmarks: "{target}.csv"}
schemes: [loop]
source: {mesh: template.ply, levels: 0, landmarks: {file: own.csv, hold_out: [d]}, rigid: {attribute: part}}
fit: {method: gauss-newton, connectivity: fixed, levels: 0, register: near-rigid}
"""


@pytest.fixture
def folder(tmp_path):
    ball = meshfit.icosphere(2)
    part = np.where(ball.verts[:, 0] > 0.5, 4, 0).astype(np.int32)
    meshfit.save_mesh(ball.with_attributes(meshfit.Attributes(vertex={"part": part})), tmp_path / "template.ply")
    meshfit.save_mesh(ball.with_verts(3 * ball.verts + [1, 2, 3]), tmp_path / "scan.ply")
    rows = zip("abcd", (3 * ball.verts + [1, 2, 3])[:4].tolist(), strict=True)
    (tmp_path / "scan.csv").write_text("name,x,y,z\n" + "".join(f"{n},{x},{y},{z}\n" for n, (x, y, z) in rows))
    (tmp_path / "own.csv").write_text("name,vertex\na,0\nb,1\nc,2\nd,3\n")
    (tmp_path / "c.yaml").write_text(CONFIG)
    return tmp_path


def trial(folder):
    (only,) = plan([load_experiment(str(folder / "c.yaml"))])
    return only


def test_the_content_of_landmark_files_is_part_of_the_identity_and_they_travel(folder):
    first = trial(folder)
    files = {"target", "source", "landmarks", "target-landmarks"}
    assert set(dict(first.inputs)) == set(first.files) == files
    (folder / "scan.csv").write_text((folder / "scan.csv").read_text() + "e,0,0,0\n")
    assert trial(folder).identity != first.identity


def test_places_and_parts_of_the_file_are_those_of_the_refined_source(folder):
    settings, target = trial(folder).settings, meshfit.load_target(folder / "scan.ply")
    landmarks = read_landmarks(settings.source, str(folder / "scan.csv"))
    frame, ball = frame_of(target), meshfit.icosphere(2)
    for levels in (0, 1):
        source = settings.source.model_copy(update={"levels": levels})
        place = str(folder / "scan.ply"), target, frame
        guidance = guidance_of(source, resolve("midpoint"), landmarks, place)
        fine = meshfit.subdivide(ball, "midpoint", levels)
        placed = guidance.landmarks
        assert np.allclose(placed.points(fine.verts), ball.verts[:4], atol=1e-6)
        assert np.allclose(placed.goals * frame.scale + frame.centre, 3 * ball.verts[:4] + [1, 2, 3], atol=1e-5)
        assert placed.used.tolist() == [True, True, True, False]
        assert np.array_equal(guidance.rigid[: ball.num_verts] == 4, ball.verts[:, 0] > 0.5)


def test_settings_that_guide_nothing_are_refused(folder):
    path = str(folder / "c.yaml")
    for change, words in (
        ("fit.register=off", "source.landmarks: only a registration uses it"),
        ("source.mesh=target", "source.landmarks: the source is made from the target"),
        ("source.landmarks=null", "target.landmarks: source.landmarks has the places on the source"),
        ("source.rigid={attribute: parts}", "source.rigid: attribute: .* has no vertex data 'parts'.*part"),
        ("source.rigid={file: a, attribute: b}", "expected either file or attribute, got both"),
        ("source.landmarks.hold_out=[x]", "source.landmarks.hold_out: 'x' is no landmark of"),
        ("target.landmarks=null", "own.csv: has places on one side alone; set target.landmarks"),
    ):
        with pytest.raises((ConfigError, MeshfitError), match=words):
            plan([load_experiment(path, [change])])
