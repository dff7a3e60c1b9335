"""Videos of fits: one frame per snapshot, from one camera; or one line about how to get snapshots."""

import re
import shlex
import subprocess

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshfit.experiment.storage.checkpoint import snapshots_in
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.solids import SOLIDS
from meshfit.report.figures.animation import read_animation
from tests.cli import answered, invoke, refused, trials_in_this_process
from tests.small import config_file
from tests.unit.test_snapshots import SECOND, quietly, taken
from tests.unit.test_trial_runner import prepared, run_trial

pillow = pytest.importorskip("PIL.Image", reason="films need pillow")
pytest.importorskip("pyvista")

pytestmark = pytest.mark.usefixtures("without_shape_checks", "fewer_target_points")


def pictures(path):
    with pillow.open(path) as film:
        found = []
        for number in range(film.n_frames):
            film.seek(number)
            found.append(np.asarray(film.convert("L"), dtype=float))
        return found


def test_a_gif_has_a_picture_for_each_moment_from_one_camera(tmp_path):
    _, _, place = taken(tmp_path, 5)
    out = answered("animate", place, "-o", tmp_path / "fit.gif", "--size", 96, "--fps", 10)
    assert re.fullmatch(r"wrote .*fit\.gif: 29 frames, 2\.9 s, [\d.]+ kB\n", out)
    found = pictures(tmp_path / "fit.gif")
    assert 4 <= len(found) <= 6
    assert {picture.shape for picture in found} == {(96 + 8, 96)}
    assert all(0.1 < (picture[:96] < 240).mean() < 0.9 for picture in found)
    assert np.abs(found[0][:96] - found[-1][:96]).mean() > 1
    assert np.array_equal(found[0][:96], pictures(tmp_path / "fit.gif")[0][:96])


@pytest.mark.slow
def test_an_mp4_has_even_sides_and_ends_with_the_result(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="films need imageio-ffmpeg")
    _, _, place = taken(tmp_path, 10)
    answered("animate", place, "-o", tmp_path / "fit.mp4", "--size", 97, "--fps", 6)
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "fit.mp4"))[0] == 3 + 2 + 12
    asked = [ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "fit.mp4"]
    assert " 98x106" in subprocess.run(asked, capture_output=True, text=True, check=False).stderr
    assert [path.name for path in tmp_path.glob("*fit*")] == ["fit.mp4"]


@pytest.mark.slow
def test_captions_tell_step_figure_and_verts_and_of_the_second_engine_the_stage(tmp_path):
    _, _, place = taken(tmp_path, 5)
    animation = read_animation(place)
    assert not animation.changes_faces
    message = [moment.caption for moment in animation.frames]
    assert [text.split("  ·  ")[0] for text in message] == [
        "source",
        *(f"step {k} of 20" for k in (5, 10, 15, 20)),
        "result",
    ]
    assert all(
        text.endswith(f"  ·  {moment.mesh.num_verts:,} vertices")
        for text, moment in zip(message, animation.frames, strict=True)
    )
    assert all("loss" in text for text in message[:-1])
    assert "Hausdorff distance" in message[-1]
    (tmp_path / "second").mkdir()
    _, _, place = taken(tmp_path / "second", 1, "gauss-newton")
    animation = read_animation(place)
    assert animation.changes_faces
    stages = dict.fromkeys(moment.caption.split("  ·  ")[0] for moment in animation.frames)
    assert list(stages) == ["source", "rough shape", "level 0", "level 1", "fine", "last", "result"]


def test_moments_are_in_the_targets_frame_whatever_frame_they_were_written_in(tmp_path):
    _, _, place = taken(tmp_path, 10)
    *_, last, result = read_animation(place).frames
    assert np.allclose(last.mesh.verts, result.mesh.verts)
    assert not np.allclose(load_mesh(place / "result.ply").verts, result.mesh.verts)


@pytest.mark.slow
def test_a_surface_that_has_not_moved_is_shown_once(tmp_path):
    settings = SECOND | {"coarse_steps": 40, "tries": 2, "snapshots": 1}
    trial, store, place = prepared(tmp_path, fit=settings)
    run_trial(trial, store, quietly)
    assert len(read_animation(place).frames) < len(snapshots_in(place)) + 2


def test_without_snapshots_one_line_says_how_to_get_them(tmp_path):
    trial, store, place = prepared(tmp_path)
    run_trial(trial, store, quietly)
    message = refused("animate", place, "-o", tmp_path / "fit.mp4")
    words = shlex.split(message.partition("no snapshots; to take some: meshfit ")[2])
    assert "fit.snapshots=1" in words
    with trials_in_this_process():
        assert invoke(*words, "-q").code == 0
    assert len(snapshots_in(place)) == trial.settings.fit.steps
    assert "'.avi' is not a video format" in refused("animate", place, "-o", tmp_path / "fit.avi")


def test_between_shapes_with_the_same_faces_ends_are_exact_and_films_and_rows_are_drawn(tmp_path):
    first = SOLIDS["cube"]()
    second = first.with_verts(Rotation.from_euler("y", 90, degrees=True).apply(first.verts.copy()))
    for name, mesh in (("first", first), ("second", second)):
        save_mesh(mesh, tmp_path / f"{name}.ply")
    shapes = [tmp_path / "first.ply", tmp_path / "second.ply"]
    arguments = ["--between", *shapes, "--steps", 2, "--size", 64]
    film, folder = tmp_path / "film.gif", tmp_path / "way"
    out = answered("animate", *arguments, "-o", film, "--meshes", folder, "--back", "--fps", 10)
    assert re.fullmatch(r"wrote 5 meshes to .*way\nwrote .*film\.gif: 28 frames, 2\.8 s, [\d.]+ kB\n", out)
    assert len(pictures(film)) == 5
    written = [load_mesh(path).verts for path in sorted(folder.iterdir())]
    assert [verts.tobytes() for verts in (written[0], written[2], written[4])] == [
        mesh.verts.tobytes() for mesh in (first, second, first)
    ]
    half = Rotation.from_euler("y", 45, degrees=True).apply(first.verts.copy())
    assert np.allclose(written[1], half)
    assert np.allclose(written[3], half)
    answered("animate", *arguments, "-o", tmp_path / "row.png", "--align", "--view", "front")
    with pillow.open(tmp_path / "row.png") as row:
        assert row.width == 3 * 64


def test_between_a_trials_source_and_its_result(tmp_path):
    _, _, place = taken(tmp_path, 5)
    answered("animate", "--between", place, "--meshes", tmp_path / "way", "--steps", 1)
    first, last = (load_mesh(tmp_path / "way" / f"shape-00{k}.ply") for k in range(2))
    assert np.allclose(last.verts, read_animation(place).frames[-1].mesh.verts)
    assert np.allclose(first.verts, read_animation(place).frames[0].mesh.verts)


def test_what_lies_between_no_shapes_is_refused(tmp_path):
    save_mesh(SOLIDS["cube"](), tmp_path / "cube.ply")
    save_mesh("icosahedron", tmp_path / "other.ply")
    film = ["-o", tmp_path / "film.gif"]
    for arguments, words in (
        (["--between", tmp_path / "cube.ply", tmp_path / "other.ply", *film], "cube and other: 8 and 12 vertices"),
        (["--between", tmp_path / "cube.ply", *film], "give two mesh files or more"),
        (["--between", tmp_path / "cube.ply", tmp_path / "cube.ply"], "expected -o FILE"),
        ([tmp_path / "cube.ply", tmp_path / "cube.ply", *film], "expected one trial, got 2; --between"),
        ([tmp_path / "cube.ply", *film, "--back"], "--back: requires --between"),
        ([tmp_path / "cube.ply"], "expected the video to write"),
    ):
        assert words in refused("animate", *arguments)


def test_what_cannot_be_written_is_refused(tmp_path):
    _, _, place = taken(tmp_path, 10)
    assert "there is no folder" in refused("animate", place, "-o", tmp_path / "gone" / "fit.gif")


@pytest.mark.slow
def test_complete_trials_without_the_snapshots_that_are_wanted_are_told_of(tmp_path):
    arguments = ["run", config_file(tmp_path), "--runs", tmp_path / "runs", "--set", "seeds=[0]", "--quiet"]
    arguments += ["--set", "schemes=[loop]"]
    assert invoke(*arguments).err == ""
    wanted = [*arguments, "--set", "fit.snapshots=10"]
    assert "1 completed trial has none of the requested snapshots; --force reruns" in invoke(*wanted).err
    assert invoke(*wanted, "--force").err == ""
    (place,) = (tmp_path / "runs" / "small-loop" / "ellipsoid" / "loop").iterdir()
    assert list(snapshots_in(place)) == [10, 20]
    assert "snapshots/" in answered("show", place)
    assert invoke(*wanted).err == ""
