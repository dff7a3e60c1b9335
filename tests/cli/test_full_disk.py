"""A disk that is really full: one line of error, and no half-written file that is taken for complete."""

import json
import re
import subprocess

import pytest

from tests.cli import answered, trials_in_this_process
from tests.cli.processes import contents, meshfit
from tests.small import CONFIG, config_file

SMALL = CONFIG.replace("schemes: [loop, interp-loop]", "schemes: [loop]").replace("seeds: [0, 1]", "seeds: [0]")
NAMES = ("result.ply", "source.ply", "trace.csv")


@pytest.fixture
def disk(tmp_path):
    """A file system of a size that can be changed."""
    place = tmp_path / "disk"
    place.mkdir()

    def resize(kib):
        command = ["mount", "-t", "tmpfs", "-o", f"{'remount,' if place.is_mount() else ''}size={kib}k", "tmpfs", place]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            pytest.skip("needs the right to mount a file system")

    yield place, resize
    if place.is_mount():
        subprocess.run(["umount", place], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("kib", [4, 16, 44])
def test_a_full_disk_ends_the_run_in_one_line_and_with_room_it_goes_on(tmp_path, disk, kib, monkeypatch):
    config = config_file(tmp_path, SMALL)
    runs, resize = disk
    resize(kib)
    _, err = meshfit("run", config, "--runs", runs, "-j", 1, "-q", folder=tmp_path, code=2)
    (line,) = err.strip().splitlines()
    assert re.fullmatch(
        r"error: \S+/disk/(small|targets)/\S+: cannot be (written|made): No space left on device.*", line
    )
    assert not contents(runs, "result.json")
    assert not list(runs.rglob("*.json.*"))
    resize(4000)
    monkeypatch.chdir(tmp_path)
    with trials_in_this_process():
        out, undisturbed = (answered("run", config, *place, "-q", "--json") for place in (("--runs", runs), ()))
    assert contents(runs, *NAMES) == contents(tmp_path / "runs", *NAMES)
    assert json.loads(out)[0]["hausdorff"] == json.loads(undisturbed)[0]["hausdorff"]
