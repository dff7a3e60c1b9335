"""Real processes that are killed: complete trials are kept, and others resume."""

import os
import signal
import subprocess
import sys
import time

import pytest

from tests.cli import invoke
from tests.cli.processes import contents, meshfit, start, wait_until, workers_of
from tests.small import CONFIG, config_file

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")

LONG = CONFIG.replace("steps: 20", "steps: 1500").replace("schemes: [loop, interp-loop]", "schemes: [loop]")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    meshfit("run", config_file(folder, LONG), "-q", folder=folder)
    return contents(folder / "runs", "result.ply", "trace.csv")


def is_alive(pid: int) -> bool:
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False)
    return bool(state.stdout.strip()) and not state.stdout.strip().startswith("Z")


@pytest.mark.slow
def test_ctrl_c_exits_130_and_the_next_run_goes_on_from_the_checkpoint(tmp_path, undisturbed):
    config = config_file(tmp_path, LONG)
    process = start("run", config, "-j", 1, folder=tmp_path)
    wait_until(lambda: bool(list((tmp_path / "runs").rglob("source.ply"))), process)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert "interrupted" in err
    assert len(list((tmp_path / "runs").rglob("checkpoint.pt"))) == 1
    assert not list((tmp_path / "runs").rglob(".*.json.*"))
    meshfit("run", config, "-q", folder=tmp_path)
    assert contents(tmp_path / "runs", "result.ply", "trace.csv") == undisturbed


@pytest.mark.slow
def test_ctrl_c_while_workers_start_is_as_quiet(tmp_path):
    process = start("run", config_file(tmp_path, LONG), "-j", 2, folder=tmp_path)
    wait_until(lambda: len(workers_of(process.pid)) > 1, process)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err


IMPORTING = """
import os, signal, sys
from meshfit.__main__ import main
class Interrupting:
    def find_spec(name, *_):
        if name == "typer":
            os.kill(os.getpid(), signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupting)
main()
"""


def test_ctrl_c_while_commands_are_imported_ends_without_a_traceback():
    ran = subprocess.run([sys.executable, "-c", IMPORTING], capture_output=True, check=False)
    assert (ran.returncode, ran.stdout, ran.stderr) == (-signal.SIGINT, b"", b"")


def test_commands_that_keep_what_they_have_done_say_so_when_they_are_interrupted(tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    for name in ("meshfit.mesh.targets.load_target", "meshfit.experiment.plan.plan"):
        monkeypatch.setattr(name, interrupted)
    resume = "; run the same command again to resume"
    for arguments, end in (
        (["measure", "bone", "bone"], ""),
        (["fit", "bone", "-o", tmp_path / "a.ply"], "; unfinished results were not written"),
        (["fit", "bone", "-o", tmp_path / "a.ply", "--keep", tmp_path / "runs"], resume),
        (["run", "quickstart", "--runs", tmp_path / "runs"], resume),
    ):
        ran = invoke(*arguments)
        assert (ran.code, ran.out, ran.err) == (130, "", f"interrupted{end}\n"), arguments


@pytest.mark.slow
def test_kill_9_loses_no_finished_trial_and_leaves_no_process_behind(tmp_path, undisturbed):
    config = config_file(tmp_path, LONG)
    process = start("run", config, "-j", 1, folder=tmp_path)
    wait_until(lambda: bool(list((tmp_path / "runs").rglob("result.json"))), process)
    children = workers_of(process.pid)
    assert children
    assert all(map(is_alive, children))
    finished = contents(tmp_path / "runs", "result.json")
    process.kill()
    process.communicate(timeout=60)
    deadline = time.monotonic() + 20
    while any(map(is_alive, children)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_alive, children))
    meshfit("run", config, "-q", folder=tmp_path)
    after = contents(tmp_path / "runs", "result.json")
    assert len(after) == 2
    assert all(after[path] == content for path, content in finished.items())
    assert contents(tmp_path / "runs", "result.ply", "trace.csv") == undisturbed


@pytest.mark.slow
def test_two_runs_in_one_directory_do_each_trial_once(tmp_path, undisturbed):
    config = config_file(tmp_path, LONG)
    first, second = (start("run", config, "-j", 1, folder=tmp_path) for _ in range(2))
    outputs = [process.communicate(timeout=120) for process in (first, second)]
    assert [first.returncode, second.returncode] == [0, 0], outputs
    assert outputs[0][0] == outputs[1][0]
    assert contents(tmp_path / "runs", "result.ply", "trace.csv") == undisturbed
