"""Image files: what is written reads back the same, in the conventions of others, and bad input is refused."""

import json
import math
import re
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from meshfit.errors import MeshfitWarning, ViewError
from meshfit.images.files import load_views, renamed, save_views
from meshfit.images.formats import decode_depth, decode_normals, encode_depth
from meshfit.images.packing import pack_target
from meshfit.images.rasteriser import render_view, shading
from meshfit.images.specs import label_of_target, title_of_target
from meshfit.images.sphere_cameras import cameras_around
from meshfit.images.target import ImageTarget, LoadedImages
from meshfit.images.targets import load_images
from meshfit.images.views import Views
from meshfit.measuring.mask_overlap import mask_ious
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.solids import icosahedron
from tests.loops import over

image = pytest.importorskip("PIL.Image", reason="images need pillow")
pytest.importorskip("OpenEXR")

SIZE = 24


def rendered(count=2, kind="pinhole"):
    mesh = icosahedron().with_verts(icosahedron().verts * (1.0, 0.7, 0.5))
    cameras = cameras_around(mesh, count, SIZE, kind=kind)
    return Views(renamed((render_view(mesh, camera) for camera in cameras), "view-"))


def written(folder, count=2, kind="pinhole", file_format="npy"):
    views = rendered(count, kind)
    save_views(folder, views, [shading(view) for view in views], file_format)
    return views


def changed(folder, change):
    path = folder / "transforms.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def save_image(path, pixels):
    path.parent.mkdir(exist_ok=True, parents=True)
    image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(path)


def png_of_16_bits(pixels):
    """A PNG of (H, W, 3 or 4) whole numbers, whose rows go through all five filters of the format in turn."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, channels = pixels.shape
    rows = np.frombuffer(pixels.astype(">u2").tobytes(), np.uint8).reshape(height, -1).astype(int)
    size, above, stream = 2 * channels, np.zeros(rows.shape[1], dtype=int), b""
    for number, row in enumerate(rows):
        left, corner = (np.concatenate([np.zeros(size, dtype=int), each[:-size]]) for each in (row, above))
        to_left, to_above, to_corner = abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)
        nearest = np.where(to_above <= to_corner, above, corner)
        paeth = np.where((to_left <= to_above) & (to_left <= to_corner), left, nearest)
        guess = [0, left, above, (left + above) // 2, paeth][number % 5]
        stream += bytes([number % 5]) + ((row - guess) % 256).astype(np.uint8).tobytes()
        above = row
    header = struct.pack(">IIBBBBB", width, height, 16, {3: 2, 4: 6}[channels], 0, 0, 0)
    parts = (b"IHDR", header), (b"IDAT", zlib.compress(stream)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts)


@over("channels", [3, 4])
def test_normals_of_16_bits_are_read_in_16_bits(channels):
    generator = np.random.default_rng(0)
    normals = generator.normal(size=(11, 7, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    numbers = np.rint((normals + 1) / 2 * 65535).astype(int)
    alpha = generator.integers(0, 65536, (11, 7, channels - 3))
    found = decode_normals(png_of_16_bits(np.concatenate([numbers, alpha], axis=2)), "n.png")
    assert np.abs(found - normals).max() < 4e-5


def test_normals_in_one_channel_are_refused(tmp_path):
    save_image(tmp_path / "grey.png", np.full((5, 5), 99))
    with pytest.raises(ViewError, match=r"grey.png: expected normals in three channels, got L pixels"):
        decode_normals((tmp_path / "grey.png").read_bytes(), "grey.png")


@over(
    "kind, file_format, depth_error, normal_error",
    [("pinhole", "npy", 0, 1e-15), ("orthographic", "exr", 1e-6, 1e-6), ("pinhole", "png", 1e-4, 0.012)],
)
def test_what_is_written_reads_back_the_same(tmp_path, kind, file_format, depth_error, normal_error):
    views = written(tmp_path, 3, kind, file_format)
    again = load_views(tmp_path).views
    assert again.names == views.names
    for one, other in zip(views, again, strict=True):
        assert one.camera == other.camera
        assert (one.mask == other.mask).all()
        assert (np.isnan(one.depth) == np.isnan(other.depth)).all()
        assert np.nanmax(np.abs(one.depth - other.depth)) <= depth_error
        assert np.nanmax(np.abs(one.normals - other.normals)) <= normal_error
    assert load_views(tmp_path / "transforms.json").sha256 == load_views(tmp_path).sha256


def test_a_packed_target_is_exactly_restored(tmp_path):
    views = rendered()
    target = ImageTarget(views, icosahedron(), "solid", Views(views[:1]))
    path = tmp_path / "solid.views.npz"
    path.write_bytes(pack_target(LoadedImages(target, "0123", "a-solid")))
    loaded = load_images(str(path))
    assert (loaded.sha256, loaded.target.name, loaded.label) == ("0123", "solid", "a-solid")
    assert (title_of_target(str(path)), label_of_target(str(path))) == ("solid", "a-solid")
    assert loaded.target.truth.verts.tobytes() == target.truth.verts.tobytes()
    for one, other in zip(views, loaded.target.views, strict=True):
        assert one.camera == other.camera
        assert one.depth.tobytes() == other.depth.tobytes()


def test_the_list_of_nerf_has_an_angle_alone_and_files_without_suffix(tmp_path):
    views = written(tmp_path)
    camera = views[0].camera

    def as_nerf(content):
        angle = 2 * math.atan(SIZE / 2 / camera.focal[0])
        frames = [
            {"file_path": f"./{frame['file_path'].removesuffix('.png')}", "transform_matrix": frame["transform_matrix"]}
            for frame in content["frames"]
        ]
        content.clear()
        content.update(camera_angle_x=angle, frames=frames)

    changed(tmp_path, as_nerf)
    for one, other in zip(views, load_views(tmp_path).views, strict=True):
        np.testing.assert_allclose(other.camera.focal, one.camera.focal)
        assert other.camera.centre == one.camera.centre
        assert (one.mask == other.mask).all()
        assert other.depth is None


def test_masks_come_from_files_drawings_and_depth_too(tmp_path):
    views = written(tmp_path)
    mask = views[0].mask
    photo = np.random.default_rng(0).integers(0, 255, (SIZE, SIZE, 3))
    save_image(tmp_path / "images/view-00.png", photo)
    assert (load_views(tmp_path).views[0].mask == mask).all()  # where there is depth
    changed(tmp_path, lambda content: [frame.pop("depth_file_path") for frame in content["frames"]])
    with pytest.raises(ViewError, match=r"view-00\.png: has no mask"):
        load_views(tmp_path)
    save_image(tmp_path / "masks/view-00.png", mask * 255)
    assert (load_views(tmp_path).views[0].mask == mask).all()
    save_image(tmp_path / "masks/view-00.png", mask * 1)
    assert (load_views(tmp_path).views[0].mask == mask).all()
    changed(tmp_path, lambda content: content["frames"][0].update(mask_path="drawn.png"))
    save_image(tmp_path / "drawn.png", ~mask * 255)
    assert (load_views(tmp_path).views[0].mask == ~mask).all()
    changed(tmp_path, lambda content: content["frames"][0].update(file_path="drawn.png", mask_path=None))
    (tmp_path / "images/view-00.png").unlink()
    save_image(tmp_path / "drawn.png", np.dstack([mask * 255] * 3))
    assert (load_views(tmp_path).views[0].mask == mask).all()


def test_normals_in_the_axes_of_the_camera_are_turned(tmp_path):
    views = written(tmp_path)
    for view in views:
        np.save(tmp_path / f"normals/{view.name}.npy", view.normals @ view.camera.pose[:3, :3])
    changed(tmp_path, lambda content: content.update(normal_axes="camera"))
    for one, other in zip(views, load_views(tmp_path).views, strict=True):
        np.testing.assert_allclose(other.normals, one.normals, atol=1e-12)


def test_colmap_files_give_the_same_cameras(tmp_path):
    views = written(tmp_path)
    (tmp_path / "transforms.json").unlink()
    rows = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"]
    for number, view in enumerate(views, 1):
        # World to camera, with y down and z ahead; the quaternion by its formula from the trace.
        rotation = np.diag([1.0, -1.0, -1.0]) @ view.camera.pose[:3, :3].T
        values, vectors = np.linalg.eig(rotation)
        axis = np.real(vectors[:, np.argmin(abs(values - 1))])
        cosine = (np.trace(rotation) - 1) / 2
        skew = np.array(
            [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
        )
        angle = math.atan2(axis @ skew / 2, cosine)
        quaternion = [math.cos(angle / 2), *(math.sin(angle / 2) * axis)]
        place = -rotation @ view.camera.position
        points = "10.0 11.5 -1" if number == 1 else ""
        rows += [" ".join(map(str, [number, *quaternion, *place, 7, f"{view.name}.png"])), points]
    lens = views[0].camera
    sparse = tmp_path / "sparse/0"
    sparse.mkdir(parents=True)
    (sparse / "images.txt").write_text("\n".join(rows) + "\n")
    (sparse / "cameras.txt").write_text(
        f"# list\n7 SIMPLE_PINHOLE {SIZE} {SIZE} {lens.focal[0]} {SIZE / 2} {SIZE / 2}\n"
    )
    for one, other in zip(views, load_views(tmp_path).views, strict=True):
        np.testing.assert_allclose(other.camera.pose, one.camera.pose, atol=1e-9)
        assert other.camera.focal == one.camera.focal
        assert (one.mask == other.mask).all()
    (sparse / "cameras.txt").write_text(f"7 SIMPLE_RADIAL {SIZE} {SIZE} 30 12 12 0.1\n")
    with pytest.raises(ViewError, match=r"cameras.txt, line 1: .*distortion, k = 0.1; undistort"):
        load_views(tmp_path)
    (sparse / "cameras.txt").unlink()
    with pytest.raises(ViewError, match=r"cameras\.txt: no such file"):
        load_views(tmp_path)


def frame(**values):
    return lambda folder: changed(folder, lambda content: content["frames"][1].update(values))


def whole(**values):
    return lambda folder: changed(folder, lambda content: content.update(values))


def without(key):
    def remove(content):
        for each in (content, *content["frames"]):
            each.pop(key, None)

    return lambda folder: changed(folder, remove)


def pose_with(row, column, value):
    def change(content):
        content["frames"][1]["transform_matrix"][row][column] = value

    return lambda folder: changed(folder, change)


def alpha(value):
    pixels = np.full((SIZE, SIZE, 4), 130)
    pixels[:, :, 3] = value
    return lambda folder: save_image(folder / "images/view-01.png", pixels)


def cut_off(folder):
    path = folder / "images/view-01.png"
    path.write_bytes(path.read_bytes()[:-40])


def png_depth(folder):
    written(folder, file_format="png")
    without("depth_unit_scale_factor")(folder)


@over(
    "change, message",
    [
        (pose_with(0, 0, 7.0), r"frames\[1\]: camera: .*not a rotation"),
        (pose_with(0, 0, "x"), r"frames\[1\]: transform_matrix"),
        (pose_with(0, 3, None), r"frames\[1\]: camera: .*not finite"),
        (frame(transform_matrix=np.diag([-1.0, 1, 1, 1]).tolist()), "mirrored"),
        (frame(transform_matrix=None), "no key 'transform_matrix'"),
        (frame(file_path=None), r"frames\[1\]"),
        (frame(file_path="images/none.png", depth_file_path=None), "none.png: no such image"),
        (frame(depth_file_path="depth/none.npy"), "none.npy: no such image"),
        (frame(w=30), "24 × 24 pixels, and its camera 30 × 24"),
        (frame(fl_x=-3.0), "focal"),
        (frame(k1=0.2), "distortion, k1 = 0.2"),
        (whole(camera_model="OPENCV_FISHEYE"), "distortion"),
        (whole(frames=[]), "lists no image"),
        (whole(frames=None), "no key 'frames'"),
        (
            lambda folder: changed(folder, lambda content: [content.pop(k) for k in ("fl_x", "camera_angle_x")]),
            "camera_angle_x",
        ),
        (lambda folder: (folder / "transforms.json").write_text("{"), "JSON is damaged at line 1"),
        (lambda folder: (folder / "transforms.json").unlink(), "has no cameras; expected transforms.json"),
        (alpha(0), "no depth within the mask|mask of 'view-01' is empty"),
        (cut_off, r"view-01\.png: damaged, or cut off"),
        (lambda folder: (folder / "images/view-01.png").write_bytes(b"none"), "not an image"),
        (lambda folder: (folder / "depth/view-01.npy").write_bytes(b"none"), "damaged"),
        (lambda folder: np.save(folder / "depth/view-01.npy", np.ones((3, 4))), "4 × 3 pixels, and its camera 24 × 24"),
        (png_depth, "depth_unit_scale_factor"),
    ],
)
def test_bad_folders_are_refused(tmp_path, change, message):
    written(tmp_path)
    change(tmp_path)
    with pytest.raises(ViewError, match=message) as caught:
        load_views(tmp_path)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_full_mask_is_refused_unless_there_is_depth(tmp_path):
    written(tmp_path)
    save_image(tmp_path / "masks/view-00.png", np.full((SIZE, SIZE), 255))
    load_views(tmp_path)
    without("depth_file_path")(tmp_path)
    with pytest.raises(ViewError, match=r"mask of 'view-00' is full"):
        load_views(tmp_path)


def test_images_of_several_sizes_need_a_camera_each(tmp_path):
    views = written(tmp_path)
    for key in ("w", "h", "fl_x", "fl_y", "cx", "cy", "depth_file_path", "normal_file_path"):
        without(key)(tmp_path)
    load_views(tmp_path)
    small = np.dstack([views[0].mask[::2, ::2] * 255] * 3)
    save_image(tmp_path / "images/view-01.png", small)
    with pytest.raises(ViewError, match=r"24 × 24 pixels, and others 12 × 12|12 × 12 pixels, and others 24 × 24"):
        load_views(tmp_path)


def test_images_without_a_camera_are_named(tmp_path):
    written(tmp_path)
    save_image(tmp_path / "images/other.png", np.zeros((4, 4)))
    with pytest.warns(MeshfitWarning, match=r"1 image without a camera left out: 'other\.png'"):
        assert len(load_views(tmp_path).views) == 2


def test_the_hash_follows_cameras_and_pixels(tmp_path):
    views = written(tmp_path)
    hashes = {load_views(tmp_path).sha256}
    frame(transform_matrix=np.eye(4).tolist())(tmp_path)
    hashes.add(load_views(tmp_path).sha256)
    shades = [shading(view) for view in views]
    mask = views[0].mask.copy()
    mask[mask.shape[0] // 2, np.flatnonzero(mask[mask.shape[0] // 2])[0]] = False
    save_views(tmp_path, Views([replace(views[0], mask=mask), views[1]]), shades, "npy")
    hashes.add(load_views(tmp_path).sha256)
    assert len(hashes) == 3


def test_masks_that_another_library_drew_are_those_of_their_cameras(tmp_path, monkeypatch):
    """The script in the documentation, which projects by itself."""
    page = (Path(__file__).parents[2] / "docs/guide/images.md").read_text(encoding="utf-8")
    (script, *_) = re.findall(r"^```py\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    short = script.replace("range(12)", "range(3)").replace('load_target("cow")', 'load_target("bone")')
    assert short.count("bone") == 1
    monkeypatch.chdir(tmp_path)
    exec(compile(short, "images.md", "exec"), {})
    mesh = load_mesh("true-cow.obj")
    views = load_views(Path("photos")).views
    assert len(views) == 3
    assert min(mask_ious(mesh, views)) > 0.97


def test_an_exr_image_is_refused_by_the_size_in_its_header(tmp_path):
    name = b"dataWindow\0box2i\0\x10\0\0\0"
    head, _, rest = encode_depth(np.ones((4, 4)), "exr", 1.0).partition(name)
    huge = head + name + rest[:8] + (59_999).to_bytes(4, "little") * 2 + rest[16:]
    with pytest.raises(ViewError, match=r"^bomb\.exr: 60000 × 60000 pixels are too many; scale it down$"):
        decode_depth(huge, "bomb.exr", None, positive=True)
