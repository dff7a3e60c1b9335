"""Refusals of files that ask for more memory than there is, before it is taken."""

import gzip
import json
import os
import struct
import threading
from contextlib import suppress

import numpy as np
import pytest

from meshfit import memory
from meshfit.errors import MeshError
from meshfit.images.packing import packed_names, unpack_target
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.targets import file_sha256
from meshfit.subdivision.sphere import icosphere


@pytest.fixture
def room(monkeypatch):
    """Set the bytes of memory that are available, which is looked up at every kB."""

    def set_room(num_bytes: int) -> None:
        monkeypatch.setattr(memory, "available_memory", lambda: num_bytes)
        monkeypatch.setattr(memory, "_UNCHECKED", 1000)

    return set_room


def test_a_file_larger_than_memory_is_not_read(tmp_path):
    path = tmp_path / "scan.obj"
    path.touch()
    os.truncate(path, 1 << 42)  # takes no space on the disk
    with pytest.raises(
        MeshError, match=r"scan\.obj: the file is read whole, about 4\.4 TB of memory, and .* available"
    ):
        load_mesh(path)


def test_a_pipe_is_read_no_further_than_memory_allows(tmp_path, room):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    room(3_000_000)

    def write() -> None:
        with path.open("wb", buffering=0) as pipe, suppress(BrokenPipeError):
            while True:
                pipe.write(bytes(1 << 16))

    writer = threading.Thread(target=write)
    writer.start()
    with pytest.raises(
        MeshError, match=r"pipe: it adds up to more than \d\.\d MB, about \d\.\d MB of memory, and 3\.0 MB"
    ):
        load_mesh(path, file_format="obj")
    writer.join(10)
    assert not writer.is_alive()


def test_compressed_content_is_unpacked_no_further_than_memory_allows(tmp_path, room):
    (tmp_path / "scan.obj.gz").write_bytes(gzip.compress(b"v 0 0 0\n" * 500_000))
    room(2_000_000)
    with pytest.raises(
        MeshError, match=r"unpack to more than \d\.\d MB, about .* and 2\.0 MB are available; if it is one"
    ):
        load_mesh(tmp_path / "scan.obj.gz")


def test_faces_that_memory_has_no_room_for_are_not_cleaned(tmp_path, room):
    save_mesh(icosphere(3), tmp_path / "scan.ply")
    room(150_000)
    with pytest.raises(
        MeshError, match=r"scan\.ply: 1,280 faces, about 192 kB of memory, and 150 kB are available; thin"
    ):
        load_mesh(tmp_path / "scan.ply")


def test_copies_in_a_scene_are_counted_before_they_are_placed(tmp_path, room):
    path = tmp_path / "scene.glb"
    save_mesh(icosphere(4), path)
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    document = json.loads(content[20 : 20 + length])
    document["nodes"] = [{"mesh": 0}] * 300
    document["scenes"] = [{"nodes": list(range(300))}]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    header = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    path.write_bytes(header + struct.pack("<I4s", len(text), b"JSON") + text + rest)
    room(10_000_000)
    with pytest.raises(
        MeshError, match=r"its scene places 1,0\d\d,\d\d\d vertices, .* about 6\d MB .*; place fewer copies"
    ):
        load_mesh(path)


def test_packed_images_are_unpacked_no_further_than_memory_allows(tmp_path, room):
    path = tmp_path / "target.views.npz"
    np.savez_compressed(path, record=np.zeros(4_000_000, dtype=np.uint8))
    assert path.stat().st_size < 10_000
    room(1_000_000)
    with pytest.raises(
        MeshError, match=r"unpacks to 4\.0 MB, about 4\.0 MB of memory, and 1\.0 MB are available; take fewer"
    ):
        unpack_target(path)


def test_packed_images_are_read_from_a_file_alone(tmp_path):
    for name, make in (("pipe", os.mkfifo), ("zeros", lambda path: path.symlink_to("/dev/zero"))):
        path = tmp_path / f"{name}.views.npz"
        make(path)
        with pytest.raises(MeshError, match=rf"{name}\.views\.npz: "):
            unpack_target(path)
        assert packed_names(path) == (name, name)


def test_a_file_larger_than_memory_is_not_hashed(tmp_path):
    path = tmp_path / "landmarks.txt"
    path.touch()
    os.truncate(path, 1 << 42)
    with pytest.raises(MeshError, match=r"landmarks\.txt: the file is read whole, about 4\.4 TB of memory"):
        file_sha256(path)
