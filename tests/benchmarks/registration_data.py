"""Write the template, targets and truth of the bundled config `register`.

python -m tests.benchmarks.registration_data data/registration
"""

import sys
from pathlib import Path

from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.io.point_clouds import save_point_cloud
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.point_cloud import PointCloud
from tests.benchmarks.skeletons import FIGURE

_POSES = {"walk": "walk", "raised": "arms raised", "squat": "squat"}
_TEMPLATE_FACES, _TARGET_FACES = 2000, 6000
_DIGITS = 6


def write(folder: Path) -> None:
    """Write all files into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rest, other_rest = (FIGURE.surface(edge) for edge in FIGURE.edges)
    template, other = rounded(decimate(rest, _TEMPLATE_FACES)), decimate(other_rest, _TARGET_FACES)
    save_mesh(template, folder / "template.ply")
    for name, pose in _POSES.items():
        change = FIGURE.posed(pose)
        save_mesh(rounded(other.with_verts(change(other.verts))), folder / f"{name}.ply")
        save_point_cloud(PointCloud(change(template.verts).round(_DIGITS)), folder / f"{name}-truth.ply")


def rounded(mesh: Mesh) -> Mesh:
    """Return a mesh to the micrometre."""
    return mesh.with_verts(mesh.verts.round(_DIGITS))


if __name__ == "__main__":
    write(Path(sys.argv[1]))
