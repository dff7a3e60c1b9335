"""The 3D part of the report as a page of its own, for meshes, trials and run directories."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path

import numpy as np

from meshfit.experiment.storage.plan_file import UpChoice
from meshfit.experiment.storage.run_directory import RESULT
from meshfit.mesh.geometry import bounding_box
from meshfit.paths import is_folder
from meshfit.report.figures.camera import camera_of, is_turned
from meshfit.report.figures.colours import DISTANCES, shared_limit
from meshfit.report.figures.render import RenderedMesh, collect_meshes, same_mesh
from meshfit.report.figures.trial_meshes import distances_to
from meshfit.report.html.environment import template_environment
from meshfit.report.html.page import MOST_TRIALS, read_report
from meshfit.report.html.target_section import read_sections
from meshfit.report.html.viewer import (
    MOST_FACES,
    ViewerMesh,
    compress,
    pack_scene,
    viewer_cloud,
    viewer_mesh,
    viewer_meshes,
    viewer_scene,
)


@dataclass(frozen=True)
class Scene:
    """Views that turn together.

    Attributes:
        title: heading of the views; may be empty.
        meshes: one for each view.
        packed: their data.
        turned: the title of the mesh that is taken to stand along z; empty if none is.
    """

    title: str
    meshes: tuple[ViewerMesh, ...]
    packed: bytes
    turned: str = ""


def collect_scenes(names: Sequence[str], against: str | None = None, up: UpChoice | None = None) -> list[Scene]:
    """Read the scenes of a page.

    Args:
        names: run directories, which give a scene for each target, and then what `collect_meshes` takes.
        against: the target that distances of meshes are measured to.
        up: the axis that points up; by default that of each experiment, or a guess.

    Raises:
        ConfigError: the distances would be in different units.
        MeshError, StoreError: a file cannot be read.
    """
    runs = [name for name in names if is_folder(name) and not (Path(name) / RESULT).exists()]
    scenes = _scenes_of_runs(list(map(Path, runs)), up) if runs else []
    others = [name for name in names if name not in runs]
    return scenes + (_scenes_of_meshes(collect_meshes(others, against)[0], up) if others else [])


def _scenes_of_runs(runs: Sequence[Path], up: UpChoice | None) -> list[Scene]:
    data = read_report(runs, [], None, datetime.now(UTC))
    sections = read_sections(data.tables, data.results, MOST_TRIALS, lambda *_: None, up)
    read = [(section, tuple(viewer_meshes(section))) for section in sections]
    return [
        Scene(section.title, meshes, viewer_scene(section, meshes), section.title if section.is_turned else "")
        for section, meshes in read
        if meshes
    ]


def _scenes_of_meshes(shown: Sequence[RenderedMesh], up: UpChoice | None) -> list[Scene]:
    """A scene for all meshes that are viewed like the same one."""
    groups: list[list[RenderedMesh]] = []
    for each in shown:
        group = next((group for group in groups if same_mesh(group[0].viewed_like, each.viewed_like)), None)
        if group is None:
            groups.append([each])
        else:
            group.append(each)
    return [_scene(group, up) for group in groups]


def _scene(shown: Sequence[RenderedMesh], up: UpChoice | None) -> Scene:
    axis = up or shown[0].up
    camera = camera_of(shown[0].viewed_like, axis)
    distances = [None if each.against is None else distances_to(each.mesh, each.against) for each in shown]
    limit = shared_limit([values for values in distances if values is not None])
    meshes = tuple(
        viewer_mesh(each.mesh, values, limit, each.title, each.against)
        if each.cloud is None
        else viewer_cloud(each.cloud, limit, each.title)
        for each, values in zip(shown, distances, strict=True)
    )
    verts = np.concatenate([each.mesh.verts for each in shown])
    centre = np.mean(bounding_box(verts), axis=0)
    axes = (camera.right, camera.up, camera.direction)
    radius = float(np.linalg.norm(verts - centre, axis=1).max()) or 1.0
    packed = pack_scene(meshes, axes, (float(centre[0]), float(centre[1]), float(centre[2])), radius)
    turned = shown[0].title if is_turned(shown[0].viewed_like, axis) else ""
    return Scene("", meshes, packed, turned)


def render_view(scenes: Sequence[Scene], title: str) -> str:
    """Return the HTML of the page, which loads nothing from the network.

    Raises:
        ConfigError: jinja2 is not installed.
    """
    targets = [
        {
            "section": {"key": f"scene-{place}", "title": scene.title},
            "meshes": scene.meshes,
            "scene": compress(scene.packed),
        }
        for place, scene in enumerate(scenes)
    ]
    assets = resources.files("meshfit.report.html") / "assets"
    context = {
        "title": title,
        "targets": targets,
        "coloured": any("values" in mesh.arrays for scene in scenes for mesh in scene.meshes),
        "colours": DISTANCES,
        "most_faces": MOST_FACES,
        "asset": lambda name: (assets / name).read_text(encoding="utf-8"),
    }
    return str(template_environment().get_template("view.html").render(context))
