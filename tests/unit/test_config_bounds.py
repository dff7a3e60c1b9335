"""Configs that ask for more than can be planned are refused before anything of that size is made."""

import os
import re
import subprocess
import sys
import threading
import time

import pytest

from meshfit.cli.console import print_error
from meshfit.config import strict_yaml
from meshfit.config.loading import load_experiment
from meshfit.errors import ConfigError, MeshError, MeshfitError
from meshfit.experiment.plan import plan
from meshfit.memory import available_memory
from meshfit.mesh.io import pipes
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.io.text import read_small_file, read_word_lines
from meshfit.mesh.solids import octahedron
from meshfit.printable import LONGEST_MESSAGE, shortened
from meshfit.subdivision.refine import subdivide
from tests.loops import over
from tests.small import experiment

_LONG = "[" + ", ".join(map(str, range(400))) + "]"


@over(
    ("text", "message"),
    [
        (
            f"sweep: {{fit.samples: {_LONG.replace('[0, ', '[')}, fit.steps: {_LONG}}}",
            "line 1: sweep: 159,600 points (399 × 400); expected 100,000 or fewer",
        ),
        (
            f"seeds: {_LONG}\ntargets: [bunny, cow]\nschemes: [loop]\nsweep: {{fit.steps: {_LONG}}}",
            "320,000 trials (2 targets × 400 seeds × 400 points of the sweep); expected 100,000 or fewer",
        ),
        ("sweep: {sample: {points: 100000}, ranges: {fit.losses.edge: [0, 1]}, fit.steps: [1, 2]}", "200,000 points"),
        (f"fit: {{steps: {10**30}}}", "line 1: fit.steps: expected a number of 1000000000 or less"),
        ("# " + "x" * 2_000_000, "larger than 2 MB"),
    ],
)
def test_a_config_that_asks_for_too_much(tmp_path, text, message):
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_experiment(str(tmp_path / "c.yaml"))


def test_a_config_of_too_many_values(tmp_path, monkeypatch):
    monkeypatch.setattr(strict_yaml, "MOST_NODES", 50)
    (tmp_path / "c.yaml").write_text(f"seeds: {_LONG}")
    with pytest.raises(ConfigError, match="line 1: not valid YAML: more than 50 values; expected fewer"):
        load_experiment(str(tmp_path / "c.yaml"))


def test_a_key_of_thousands_of_parts():
    with pytest.raises(ConfigError, match=r"a\.a\.a…: no such key: it has 3,000 parts; settings have 16 or fewer"):
        load_experiment("tutorial", [".".join("a" * 3000) + "=1"])


def test_duplicates_among_many_seeds_are_found(tmp_path):
    (tmp_path / "c.yaml").write_text(f"seeds: {_LONG[:-1]}, 7]")
    with pytest.raises(ConfigError, match="duplicate entry 7"):
        load_experiment(str(tmp_path / "c.yaml"))


@over("read", [read_small_file, load_mesh])
def test_a_pipe_without_a_writer_does_not_hang(tmp_path, monkeypatch, read):
    monkeypatch.setattr(pipes, "_SECONDS_FOR_A_WRITER", 0.1)
    os.mkfifo(tmp_path / "pipe.obj")
    with pytest.raises(MeshError, match=r"pipe\.obj: a pipe that nothing is written to; give the path of a file"):
        read(tmp_path / "pipe.obj")


def test_a_pipe_waits_for_a_slow_writer(tmp_path):
    os.mkfifo(tmp_path / "pipe.txt")

    def write() -> None:
        with (tmp_path / "pipe.txt").open("wb") as pipe:  # returns once there is a reader
            time.sleep(0.2)
            pipe.write(b"1 2\n")

    writer = threading.Thread(target=write)
    writer.start()
    assert read_small_file(tmp_path / "pipe.txt") == b"1 2\n"
    writer.join()


def test_a_pipe_with_a_writer_is_read():
    reader, writer = os.pipe()
    os.write(writer, b"1 2 # three\n")
    os.close(writer)
    assert list(read_word_lines(f"/dev/fd/{reader}")) == [(1, ["1", "2"])]
    os.close(reader)


def test_a_small_file_that_is_too_large(tmp_path):
    with (tmp_path / "large.txt").open("wb") as file:
        file.truncate(100_000_001)  # without a byte on the disk
    with pytest.raises(MeshError, match=r"large\.txt: larger than 100 MB"):
        read_small_file(tmp_path / "large.txt")


@over("length", [0, 5, LONGEST_MESSAGE, LONGEST_MESSAGE + 1, 100_000])
def test_messages_keep_their_ends(length, capsys):
    message = ("ab" * length)[:length]
    short = shortened(message)
    assert len(short) == min(length, LONGEST_MESSAGE)
    assert short == message or (message.startswith(short[:200]) and message.endswith(short[-200:]))
    print_error(message)
    print_error("\0" * length)  # each as four characters
    assert max(map(len, capsys.readouterr().err.splitlines())) < 500


def test_a_binary_file_is_no_list_of_words(tmp_path):
    (tmp_path / "creases.txt").write_bytes(bytes(5000))
    with pytest.raises(MeshError, match=r"creases\.txt: not a text file in UTF-8$"):
        list(read_word_lines(tmp_path / "creases.txt"))


def test_levels_that_memory_has_no_room_for_are_refused_before_they_are_made(tmp_path, monkeypatch):
    monkeypatch.setattr("meshfit.memory.available_memory", lambda: 1_000_000)
    assert subdivide(octahedron(), "loop", 3).num_faces == 512
    for scheme, levels, faces, size in (
        ("loop", 5, "8,192", "1.6"),
        ("sqrt3", 6, "5,832", "1.2"),
        ("catmull-clark", 6, "24,576", "12"),
    ):
        makes = f"^{levels} levels make about {faces} faces, about {size} MB of memory, and 1.0 MB are available; take"
        with pytest.raises(MeshError, match=makes):
            subdivide(octahedron(), scheme, levels)
    with pytest.raises(MeshfitError, match=r"^source.levels: 8 levels make about 524,288 faces, about 105 MB"):
        plan([experiment(tmp_path, source={"mesh": "octahedron", "levels": 8})])


def test_available_memory_is_that_of_the_system_or_of_the_limit_of_the_process():
    available = available_memory()
    assert available is None or 10**7 < available < 10**14
    limit = "import resource as r; r.setrlimit(r.RLIMIT_AS, (2**31,) * 2)"
    code = f"{limit}; import meshfit.memory as m; print(m.available_memory())"
    limited = int(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True).stdout)
    assert 0 < limited < 2**31
