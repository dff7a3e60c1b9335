"""An experiment small enough to really run in a test: a coarse ball fitted to an ellipsoid."""

from pathlib import Path

import numpy as np

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.loading import Experiment
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import octahedron
from meshfit.settings import override
from meshfit.subdivision.refine import subdivide

SETTINGS = {
    "schemes": ["loop"],
    "source": {"mesh": "octahedron", "levels": 2},
    "fit": {"steps": 20, "samples": 100, "trace_every": 5},
    "measure": {"samples": 500, "points": 500},
    "device": "cpu",
}


def ellipsoid(folder: Path, name: str = "ellipsoid.ply") -> Path:
    ball = subdivide(octahedron(), "loop", 3)
    save_mesh(Mesh(ball.verts * np.array([1.0, 0.8, 0.6]), ball.faces), folder / name)
    return folder / name


def experiment(folder: Path, **changes: object) -> Experiment:
    settings = override(ExperimentSettings(), SETTINGS | {"targets": [str(ellipsoid(folder))]})
    return Experiment("small", override(settings, changes))


CONFIG = """\
targets: [ellipsoid.ply]
schemes: [loop, interp-loop]
seeds: [0, 1]
source: {mesh: octahedron, levels: 2}
fit: {steps: 20, samples: 100, trace_every: 5}
measure: {samples: 500, points: 500}
device: cpu
"""


def config_file(folder: Path, text: str = CONFIG) -> Path:
    ellipsoid(folder)
    path = folder / "small.yaml"
    path.write_text(text, encoding="utf-8")
    return path
