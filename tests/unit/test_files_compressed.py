"""Compressed mesh files: read and written as what is in them, the same bytes each time; damaged ones are refused."""

import bz2
import contextlib
import gzip
import io
import lzma
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest

from meshfit.config.loading import load_experiment
from meshfit.errors import MeshError
from meshfit.experiment.plan import plan
from meshfit.mesh.curves import Curves
from meshfit.mesh.io.compression import COMPRESSIONS, compress, decompress
from meshfit.mesh.io.files import (
    CURVE_FORMATS,
    FORMATS,
    READABLE_FORMATS,
    encode_mesh,
    load_curves,
    load_mesh,
    load_polygons,
    save_curves,
    save_mesh,
)
from meshfit.mesh.solids import octahedron
from meshfit.mesh.targets import target_title
from meshfit.paths import COMPRESSION_SUFFIXES
from tests.cli import answered, invoke
from tests.loops import over

PACK = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}
UNPACK = {".gz": gzip.decompress, ".bz2": bz2.decompress, ".xz": lzma.decompress}
WRITTEN = [suffix for suffix, form in FORMATS.items() if form.write is not None]


def refusal(path):
    with pytest.raises(MeshError) as error:
        load_mesh(path)
    text = str(error.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


@over("packed", COMPRESSION_SUFFIXES)
@over("suffix", WRITTEN)
def test_every_format_is_written_and_read_compressed(tmp_path, suffix, packed):
    plain, path = tmp_path / f"a{suffix}", tmp_path / f"A{suffix.upper()}{packed.upper()}"
    for file in (plain, path):
        save_mesh(octahedron(), file)
    assert UNPACK[packed](path.read_bytes()) == plain.read_bytes()
    for load in (load_mesh, load_polygons):
        assert load(path).verts.tobytes() == load(plain).verts.tobytes()


def test_curves_are_written_and_read_compressed(tmp_path):
    curves = Curves.through(np.eye(3))
    for suffix in CURVE_FORMATS:
        save_curves(curves, tmp_path / f"a{suffix}.gz")
        assert np.array_equal(load_curves(tmp_path / f"a{suffix}.gz").verts, np.eye(3))


def test_the_same_mesh_gives_the_same_bytes_without_time_or_name(tmp_path):
    (tmp_path / "later").mkdir()
    for name in ("a.ply.gz", "later/b.ply.gz"):
        save_mesh(octahedron(), tmp_path / name)
    content = (tmp_path / "a.ply.gz").read_bytes()
    assert content == (tmp_path / "later" / "b.ply.gz").read_bytes()
    assert content[:10] == b"\x1f\x8b\x08\0\0\0\0\0\0\xff"


@over("suffix", [".gz", ".xz", ".bz2"])
def test_damaged_and_cut_compression(tmp_path, suffix):
    path, kind = tmp_path / f"a.ply{suffix}", COMPRESSIONS[suffix].name
    content = PACK[suffix](encode_mesh(octahedron(), ".ply") + np.random.default_rng(0).bytes(3000))
    damaged = content[: len(content) // 2] + b"\0\0\0\0" + content[len(content) // 2 + 4 :]
    cut = f"its {kind} compression is cut short; copy or download it again"
    cases = {
        content[:-12]: cut,
        content[: len(content) // 2]: cut,
        COMPRESSIONS[suffix].start: cut,
        damaged: f"its {kind} compression is damaged; copy or download it again",
        b"": "the file is empty",
        PACK[suffix](b""): "the file is empty",
        PACK[suffix](b" \n"): "the file is empty",
        encode_mesh(octahedron(), ".ply"): f"its content is not compressed with {kind}; rename it to 'a.ply'",
        PACK[suffix](content): f"its content is compressed with {kind}; rename it to 'a.ply{suffix}{suffix}'",
    }
    for data, message in cases.items():
        path.write_bytes(data)
        assert refusal(path) == message


def test_a_compressed_file_without_the_suffix_of_its_format_is_recognised(tmp_path):
    for suffix, pack in PACK.items():
        for form in (".obj", ".ply", ".off"):
            content = pack(encode_mesh(octahedron(), form))
            for name in (f"scan{suffix}", "scan.dat", f"scan.v2.dat{suffix}"):
                (tmp_path / name).write_bytes(content)
                stem = "scan.v2" if "v2" in name else "scan"
                assert refusal(tmp_path / name).endswith(
                    f"; its content looks like {form[1:].upper()}; rename it to '{stem}{form}{suffix}'"
                )
                assert load_mesh(tmp_path / name, file_format=form).num_faces == 8
        (tmp_path / "cut.dat").write_bytes(content[: len(COMPRESSIONS[suffix].start) + 1])
        assert refusal(tmp_path / "cut.dat") == f"unknown mesh format '.dat'; allowed: {', '.join(READABLE_FORMATS)}"


@over("seed", range(3))
@over("suffix", [".gz", ".xz", ".bz2"])
def test_any_damage_is_refused_or_harmless(suffix, seed):
    content = PACK[suffix](encode_mesh(octahedron(), ".ply"))
    random = np.random.default_rng(seed)
    for _ in range(60):
        data = bytearray(content)
        data[random.integers(len(data))] = random.integers(256)
        with contextlib.suppress(MeshError):
            decompress(bytes(data[: random.integers(1, len(data) + 1)]), suffix)


@over("suffix", [".gz", ".xz", ".bz2"])
def test_a_bomb_is_stopped(suffix):
    """A few kB unpack to 1.6 MB, 1.6 GB and more; what is unpacked is limited to 16 MB."""
    bomb = PACK[suffix](bytes(20_000_000))
    assert len(bomb) < 80_000
    start = time.perf_counter()
    with pytest.raises(MeshError, match=r"unpack to more than 16 MB, as no mesh file should; if it is one, unpack it"):
        decompress(bomb, suffix)
    assert time.perf_counter() - start < 2
    assert decompress(PACK[suffix](bytes(15_000_000)), suffix) == bytes(15_000_000)


def test_files_of_several_streams_and_of_the_command_line_tools(tmp_path):
    """As `cat a.gz b.gz` and `gzip` write them, with time and name."""
    content = encode_mesh(octahedron(), ".off")
    half = len(content) // 2
    for suffix, pack in PACK.items():
        (tmp_path / f"a.off{suffix}").write_bytes(pack(content[:half]) + pack(content[half:]))
        assert load_mesh(tmp_path / f"a.off{suffix}").num_faces == 8
    packed = io.BytesIO()
    with gzip.GzipFile("name.off", "wb", fileobj=packed, mtime=1e9) as stream:
        stream.write(content)
    assert decompress(packed.getvalue(), ".gz") == content


@over(
    ("name", "message"),
    [
        ("a.zip", "a ZIP archive cannot be read; unpack it first"),
        ("a.obj.zip", "a ZIP archive cannot be read; unpack it first"),
        ("a.obj", "its content looks like a ZIP archive, not OBJ; unpack it first"),
        ("a.tar.gz", "a tar archive cannot be read; unpack it first"),
        ("a.tgz", "a tar archive cannot be read; unpack it first"),
        ("a.ply.zst", "a file compressed with zstd cannot be read; unpack it first"),
        ("a.ply.Z", "a file compressed with compress cannot be read; unpack it first"),
        ("a.7z", "a 7z archive cannot be read; unpack it first"),
    ],
)
def test_archives_are_refused_by_name(tmp_path, name, message):
    with zipfile.ZipFile(tmp_path / name, "w") as archive:
        archive.writestr("a.obj", encode_mesh(octahedron(), ".obj"))
    assert refusal(tmp_path / name) == message


def test_a_python_without_a_kind_of_compression(monkeypatch):
    monkeypatch.setitem(sys.modules, "lzma", None)
    with pytest.raises(MeshError, match=r"^this Python was built without xz; unpack the file first$"):
        decompress(b"\xfd7zXZ\x00", ".xz")


def test_commands_take_compressed_files_and_name_them_by_their_stem(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_mesh(octahedron(), "solid.obj.gz")
    assert answered("subdivide", "solid.obj.gz", "out.stl.xz").startswith("out.stl.xz: 8 faces → 32 faces")
    assert invoke("measure", "out.stl.xz", "solid.obj.gz", "--samples", 100).code == 0
    experiment = load_experiment("quickstart", ["targets=[solid.obj.gz]", "source.mesh=solid.obj.gz", "schemes=[loop]"])
    (trial,) = plan([experiment])
    assert trial.label == "solid · loop · seed 0"
    assert trial.plain_settings["source"]["mesh"] == str(tmp_path / "solid.obj.gz")
    assert target_title("a/solid.obj.gz") == "solid"


def test_the_command_line_tool_reads_what_is_written(tmp_path):
    save_mesh(octahedron(), tmp_path / "a.obj.gz")
    done = subprocess.run(["gzip", "-dc", tmp_path / "a.obj.gz"], capture_output=True, check=True)
    assert done.stdout == encode_mesh(octahedron(), ".obj")


def test_the_suffixes_are_those_of_the_table():
    assert tuple(COMPRESSIONS) == COMPRESSION_SUFFIXES
    for suffix in COMPRESSIONS:
        assert decompress(compress(b"abc", suffix), suffix) == b"abc"
