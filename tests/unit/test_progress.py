"""Progress lines: one per trial, one for several that end too fast, and one per minute while none ends."""

import re
import time

import pytest

from meshfit.cli import console
from meshfit.cli.console import reading, working
from meshfit.cli.fit_progress import FitProgress
from meshfit.cli.progress import TrialLines, show_parts
from meshfit.experiment.plan import plan
from meshfit.experiment.running.batch_runner import run_batch
from meshfit.experiment.running.shared_progress import SharedProgress
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.trial_status import Outcome, Progress, TrialStatus
from meshfit.fitting.callbacks import Step
from tests.small import experiment


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def watched(tmp_path):
    trials = plan([experiment(tmp_path, seeds=list(range(300)))])
    progress, clock, outcomes = SharedProgress.of(300), Clock(), {}
    lines = TrialLines(trials, clock)

    def end(i, phase=TrialStatus.COMPLETE, message=""):
        progress[i] = Progress(phase)
        outcomes[i] = Outcome(phase, message)

    def look(seconds=0.1):
        clock.now += seconds
        lines.update(progress, outcomes)

    return progress, end, look


def test_trials_that_end_slowly_are_named(watched, capsys):
    _, end, look = watched
    for i in range(30):
        end(i)
        look(seconds=10)
    text = capsys.readouterr().err.splitlines()
    assert len(text) == 30
    assert text[0] == "[1/300] ellipsoid · loop · seed 0: complete"


def test_trials_that_end_fast_are_counted_and_failures_still_named(watched, capsys):
    _, end, look = watched
    for i in range(300):
        end(i, *((TrialStatus.FAILED, "diverged: so it goes") if i == 200 else ()))
        look(seconds=0.2)
    text = capsys.readouterr().err.splitlines()
    assert len(text) < 45
    assert sum("seed 200: failed: diverged: so it goes" in line for line in text) == 1
    assert text[-1].startswith("[300/300]")
    named = sum(line.endswith(": complete") for line in text)
    counted = sum(int(found[1]) for line in text if (found := re.search(r"(\d+) more are complete", line)))
    assert named + counted == 299
    look()
    assert not capsys.readouterr().err


def test_what_was_complete_before_is_one_line(watched, capsys):
    progress, end, look = watched
    for i in range(290):
        end(i)
        progress.reset(i)
    look()
    assert capsys.readouterr().err == "[290/300] complete already\n"


def test_a_minute_in_which_nothing_ends_has_a_sign_of_life(watched, capsys):
    progress, _, look = watched
    look()
    progress[0] = Progress(TrialStatus.FITTING, Step(10, 20, 0.5))
    for _ in range(600):
        look()
    (text,) = capsys.readouterr().err.splitlines()
    assert text == "[0/300] 1 running, 299 waiting; about 9 h 59 min left"


def test_parts_are_printed_at_a_rate_that_can_be_read_and_their_end_in_any_case(capsys):
    with show_parts(quiet=False) as show:
        for done in range(101):
            show("drawing", done, 100)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "drawing: 0 of 100"
    assert lines[-1] == "drawing: 100 of 100"
    assert len(lines) < 25
    with show_parts(quiet=True) as show:
        show("drawing", 1, 1)
    assert capsys.readouterr().err == ""


def test_a_control_mesh_that_takes_time_is_named_with_the_time(tmp_path):
    """Its phase is that of a trial whose source is made from the target, and of no other."""
    seen = {}
    for mesh in ("octahedron", "target"):
        source = {"mesh": mesh} if mesh == "octahedron" else {"mesh": mesh, "decimate": 100, "levels": 0}
        (trial,) = plan([experiment(tmp_path, source=source, targets=[str(tmp_path / "ellipsoid.ply")])])
        statuses = seen[mesh] = list[TrialStatus]()
        run_batch([trial], RunDirectory(tmp_path / mesh), lambda _, progress, to=statuses: to.append(progress.status))
    assert TrialStatus.PREPARING not in seen["octahedron"]
    assert seen["target"][:3] == [TrialStatus.FITTING, TrialStatus.PREPARING, TrialStatus.FITTING]
    assert all(status.is_running for status in seen["target"])

    now = [0.0]
    shown, progress = FitProgress(trial, lambda: now[0]), SharedProgress.of(1)
    texts = []
    for status, seconds in (("fitting", 1), ("preparing", 2), ("preparing", 9), ("fitting", 10)):
        now[0] = seconds
        progress[0] = Progress(TrialStatus(status))
        texts.append(shown.update(progress))
    assert texts == ["loading", "making the control mesh, 0 s", "making the control mesh, 7 s", "starting the fit"]


def test_work_that_takes_seconds_is_named_once(monkeypatch, capsys):
    for seconds, quiet, said in ((10, False, ""), (0.01, False, "reading a mesh\n"), (0.01, True, "")):
        monkeypatch.setattr(console, "_SECONDS_UNTIL_SAID", seconds)
        with working("reading a mesh", quiet=quiet):
            time.sleep(0.1)
        assert capsys.readouterr().err == said


def test_large_targets_are_named_before_they_are_read(tmp_path, monkeypatch, capsys):
    path = tmp_path / "scan.ply"
    path.write_bytes(b"ply\n" * 500)
    monkeypatch.setattr(console, "_LARGE_FILES", 2000)
    for targets, quiet, said in (
        ([str(path), str(path)], False, "reading the targets, 2.0 kB\n"),
        ([str(path)], True, ""),
        (["bunny", "/dev/zero", "missing.ply"], False, ""),
    ):
        with reading(targets, quiet=quiet):
            assert capsys.readouterr().err == said
