"""Fits by external tools: commands that work, fail, hang, flood or leave processes behind, and what is made of each."""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from meshfit.errors import ConfigError
from meshfit.experiment.storage.failure import RETRIED, failure_kind
from meshfit.fitting.batch import fit_batch
from meshfit.fitting.callbacks import Interrupted
from meshfit.fitting.external.engine import External, run_external
from meshfit.fitting.external.tools import ToolError
from meshfit.fitting.fit import fit
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import ExternalSettings
from meshfit.mesh.solids import icosahedron, octahedron
from tests.loops import over

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")

COPY = "import shutil, sys; shutil.copy(sys.argv[1], sys.argv[2])"


def python(folder, code, *arguments, name="tool.py", **settings):
    """Settings of a command that runs a Python script."""
    script = folder / name
    script.write_text(code, encoding="utf-8")
    command = (sys.executable, "-I", "-S", str(script), *arguments)
    return ExternalSettings(command=command, **settings)


def problem(**changes):
    return Problem(icosahedron(), octahedron(), **changes)


def failure(settings, **changes):
    with pytest.raises(ToolError) as caught:
        run_external(problem(**changes), settings)
    return caught.value


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("file_format", ["ply", "obj"])
def test_what_the_tool_writes_is_the_result_in_the_coordinates_of_the_target(tmp_path, file_format):
    settings = python(tmp_path, COPY, "{source}", "{result}", name="copy.py", format=file_format)
    source, target = icosahedron(), octahedron().with_verts(25.4 * octahedron().verts + 100)
    placed = source.with_verts(20 * source.verts + 100)
    result = fit(placed, target, settings, allow_commands=True)
    np.testing.assert_allclose(result.mesh.verts, placed.verts, rtol=1e-14)
    assert np.array_equal(result.mesh.faces, source.faces)
    assert result.tool.name == "copy.py"
    assert not result.trace.rows
    assert 0 < result.tool.peak_memory_mb < 200
    assert 0 < result.tool.seconds < 30


def test_polygons_stay_polygons(tmp_path):
    code = "import sys; open(sys.argv[1], 'w').write('v 0 0 0\\nv 1 0 0\\nv 1 1 0\\nv 0 1 0\\nf 1 2 3 4\\n')"
    (result,) = fit_batch([problem()], python(tmp_path, code, "{result}", format="obj"), allow_commands=True)
    assert result.polygons.num_faces == 1
    assert result.mesh.num_faces == 2


def test_placeholders_stand_for_paths_and_numbers_and_other_braces_for_themselves(tmp_path):
    code = "import json, os, shutil, sys; shutil.copy(*sys.argv[1:3]); print(json.dumps([sys.argv[3:], os.getcwd()]))"
    settings = python(tmp_path, code, "{source}", "{result}", "--seed={seed}", "{}", "{folder}", "a b; $(c) *")
    _, run = run_external(problem(seed=7), settings)
    assert '"--seed=7", "{}"' in run.output
    assert '"a b; $(c) *"' in run.output
    folder = Path(run.output.rpartition(", ")[2].strip('"]'))
    assert f'"{folder}"' in run.output
    assert not folder.exists()


def test_the_environment_holds_what_programs_need_and_no_secrets(tmp_path, monkeypatch):
    monkeypatch.setenv("API_TOKEN", "secret")
    monkeypatch.setenv("LICENCE_FILE", "here")
    code = f"import os; print(sorted(os.environ)); {COPY}"
    settings = python(tmp_path, code, "{source}", "{result}", environment=("LICENCE_FILE",))
    _, run = run_external(problem(), settings)
    assert "API_TOKEN" not in run.output
    assert "'LICENCE_FILE'" in run.output
    assert "'PATH'" in run.output
    assert "'TMPDIR'" in run.output


def test_the_version_is_the_first_line_of_its_command(tmp_path):
    settings = python(tmp_path, COPY, "{source}", "{result}")
    version = ("echo", "\x1b[1mtool 1.2\x1b[0m".replace("\x1b", ""))
    _, run = run_external(problem(), settings.model_copy(update={"version_command": version}))
    assert run.version == "[1mtool 1.2[0m"
    missing = settings.model_copy(update={"version_command": ("no-such-program", "--version")})
    assert "no-such-program: cannot be started" in str(failure(missing))


@over(
    "code, kind, message",
    [
        ("import sys; print('no licence'); sys.exit(3)", "tool", "tool.py ended with exit code 3: no licence"),
        ("import os; os.kill(os.getpid(), 11)", "tool", "tool.py was ended by SIGSEGV (Segmentation fault)"),
        ("import os; os.kill(os.getpid(), 9)", "killed", "tool.py was killed; perhaps there was not enough memory"),
        ("pass", "tool", "tool.py wrote no result.ply, which {result} stands for"),
        ("open('out.stl', 'w')", "tool", "stands for; it wrote out.stl"),
        ("import sys; open(sys.argv[1], 'wb').write(bytes(range(256)))", "tool", "wrote a result that cannot be used"),
        ("import sys; open(sys.argv[1], 'w')", "tool", "wrote a result that cannot be used: result.ply"),
        ("import os, sys; os.symlink('/etc/passwd', sys.argv[1])", "tool", "tool.py wrote no result.ply"),
    ],
)
def test_each_failure_is_named_in_one_line(tmp_path, code, kind, message):
    error = failure(python(tmp_path, code, "{result}"))
    assert message in str(error)
    assert "\n" not in str(error)
    assert (error.kind, failure_kind(error)) == (kind, kind)
    assert (failure_kind(error) in RETRIED) == (kind == "killed")


def test_positions_that_are_not_finite_are_refused(tmp_path):
    code = "import sys; open(sys.argv[1], 'w').write('v nan 0 0\\nv 1 0 0\\nv 1 1 0\\nf 1 2 3\\n')"
    assert "cannot be used" in str(failure(python(tmp_path, code, "{result}", format="obj")))


def test_a_missing_program_is_named():
    error = failure(ExternalSettings(command=("no-such-program", "{result}")))
    assert "no-such-program: cannot be started: No such file or directory; is no-such-program installed" in str(error)


@pytest.mark.parametrize("escapes", [False, True])
def test_a_tool_that_hangs_is_stopped_with_all_that_it_started(tmp_path, escapes):
    code = f"""
import os, subprocess, sys, time
child = subprocess.Popen([sys.executable, '-I', '-S', '-c', 'import time; time.sleep(60)'], start_new_session={escapes})
open({str(tmp_path / "pids")!r}, 'w').write(f'{{os.getpid()}} {{child.pid}}')
time.sleep(60)
"""
    start = time.monotonic()
    error = failure(python(tmp_path, code, "{result}", time_limit=1.0))
    assert time.monotonic() - start < 20
    assert (error.kind, str(error)) == ("time-limit", "tool.py was stopped after 1 s; raise fit.time_limit")
    if sys.platform == "linux":
        assert not any(is_running(pid) for pid in (tmp_path / "pids").read_text().split())


def test_a_tool_that_leaves_a_process_behind_does_not_keep_it(tmp_path):
    code = f"""
import os, shutil, sys, time
if os.fork() == 0:
    os.setsid()
    open({str(tmp_path / "pid")!r}, 'w').write(str(os.getpid()))
    time.sleep(60)
while not os.path.exists({str(tmp_path / "pid")!r}):
    time.sleep(0.01)
shutil.copy(*sys.argv[1:])
"""
    start = time.monotonic()
    run_external(problem(), python(tmp_path, code, "{source}", "{result}"))
    assert time.monotonic() - start < 20
    if sys.platform == "linux":
        assert not is_running((tmp_path / "pid").read_text())


def test_an_interrupted_fit_stops_the_tool(tmp_path):
    code = f"import os, time; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); time.sleep(60)"

    def stop(step):
        assert (step.done, step.steps) == (0, 1)
        if (tmp_path / "pid").is_file():
            raise Interrupted

    with pytest.raises(Interrupted):
        run_external(problem(on_step=stop), python(tmp_path, code, "{result}"))
    assert not is_running((tmp_path / "pid").read_text())


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc")
def test_a_tool_that_takes_too_much_memory_is_stopped(tmp_path):
    code = "import time; held = bytearray(200_000_000); time.sleep(60)"
    error = failure(python(tmp_path, code, "{result}", memory_limit=100.0))
    assert (error.kind, str(error)) == (
        "memory-limit",
        "tool.py was stopped at 100 MB of memory; raise fit.memory_limit",
    )


def test_output_is_bounded_and_without_control_characters(tmp_path):
    code = f"import sys; print('first'); print('\\x1b[31m' + 'x' * 20_000_000); print('last'); {COPY}"
    _, run = run_external(problem(), python(tmp_path, code, "{source}", "{result}"))
    assert len(run.output) < 40_000
    assert run.output.startswith("first\n\\x1b[31mxxx")
    assert run.output.endswith("\nlast")
    assert "bytes left out" in run.output


def test_what_a_tool_wrote_survives_in_a_checkpoint(tmp_path):
    settings = python(tmp_path, COPY, "{source}", "{result}")
    import torch

    engine = External([problem()], settings, torch.device("cpu"), torch.float32)
    engine.step()
    path = tmp_path / "checkpoint.pt"
    torch.save(engine.checkpoint(0), path)
    resumed = External([problem()], settings, torch.device("cpu"), torch.float32)
    resumed.restore([torch.load(path, weights_only=True)])
    assert resumed.done == resumed.steps
    assert resumed.mesh(0).verts.tobytes() == engine.mesh(0).verts.tobytes()
    assert resumed.tool(0) == engine.tool(0)


def test_commands_are_refused_unless_they_are_allowed(tmp_path):
    settings = python(tmp_path, COPY, "{source}", "{result}")
    for run in (lambda: fit(icosahedron(), octahedron(), settings), lambda: fit_batch([problem()], settings)):
        with pytest.raises(ConfigError, match=r"tool\.py is run only with allow_commands=True"):
            run()


@over(
    "settings, message",
    [
        ({}, "expected either tool or command, got neither"),
        ({"tool": "poisson", "command": ["a", "{result}"]}, "expected either tool or command, got both"),
        ({"tool": "poison"}, "did you mean 'poisson'?"),
        ({"tool": "poisson", "options": {"deph": 6}}, "options.deph: no such key: did you mean 'depth'?"),
        ({"tool": "poisson", "options": {"depth": 60}}, "options.depth: expected a number of 12 or less, got 60"),
        ({"tool": "poisson", "format": "obj"}, "format: only a command has it"),
        ({"command": ["a", "{result}"], "options": {"x": 1}}, "a command has none; give them as arguments"),
        ({"command": ["a", "{source}"]}, "none of its arguments holds {result}"),
        ({"command": ["a", "{resutl}"]}, "did you mean 'result'?"),
        ({"command": ["a\x1b", "{result}"]}, "control characters"),
        ({"command": []}, "at least one entry"),
        ({"command": "a {result}"}, "expected a list"),
        ({"command": ["a", "{result}"], "steps": 5}, "fit.steps: no such key"),
        ({"command": ["a", "{result}"], "time_limit": 0}, "fit.time_limit: expected a number above 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, message):
    from meshfit.config.experiment import ExperimentSettings
    from meshfit.settings import build

    with pytest.raises(ConfigError) as caught:
        build(ExperimentSettings, {"fit": {"method": "external"} | settings})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_supervisor_ends_the_tool_when_its_caller_is_killed(tmp_path):
    import subprocess

    tool = f"import os, time; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    caller = f"""
from pathlib import Path
from meshfit.fitting.external.process import Limits, run_process
folder = Path({str(tmp_path)!r}, 'work')
folder.mkdir()
run_process([{sys.executable!r}, '-I', '-S', '-c', {tool!r}], folder, {{}}, Limits(60))
"""
    process = subprocess.Popen([sys.executable, "-c", caller], env=os.environ)
    deadline = time.monotonic() + 60
    while not (tmp_path / "pid").is_file() or not (tmp_path / "pid").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    pid = (tmp_path / "pid").read_text()
    process.kill()
    process.wait()
    while is_running(pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(pid)
