"""The metamorphosis between mouse and bunny: errors of landmarks, and the pictures of docs/guide/metamorphosis.md.

python -m tests.benchmarks.metamorphosis RUNS FOLDER    # 2 minutes

RUNS is a run directory in which `meshfit run metamorphosis` is complete. Landmarks were placed by hand.
"""

import sys
from pathlib import Path

import numpy as np

import meshfit
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.report.figures.shape_animation import NamedShape, aligned, shapes_of_trial, steps_between, write_row
from meshfit.report.figures.trial_meshes import read_trial_meshes

# Vertices of the named targets: the tips of the right and the left ear, and the nose.
LANDMARKS = {"mousehead": [137, 5557, 2868], "bunny": [22257, 8082, 1433]}
_VIEW = "-35,15"


def errors_by_a_sphere(runs: Path) -> tuple[list[NamedShape], np.ndarray]:
    """Return the results of the config, and how far the bunny's landmarks are from the mouse's, as shares."""
    folders = {name: next((runs / "metamorphosis" / name / "loop").glob("seed-0-*")) for name in LANDMARKS}
    shapes = {name: shapes_of_trial(folder)[1] for name, folder in folders.items()}
    places = {
        name: read_trial_meshes(folders[name]).frame.normalise(meshfit.load_target(name)).verts[verts]
        for name, verts in LANDMARKS.items()
    }
    away = np.linalg.norm(shapes["bunny"].mesh.verts[:, None] - places["bunny"], axis=2)
    mouse = shapes["mousehead"].mesh.verts
    errors = np.linalg.norm(mouse[away.argmin(axis=0)] - places["mousehead"], axis=1)
    return [shapes["bunny"], shapes["mousehead"]], errors / bounding_box_diagonal(mouse)


def errors_by_registration() -> tuple[list[NamedShape], np.ndarray]:
    """Return the mouse, the bunny registered from it, and the errors of the landmarks given, as shares."""
    mouse, bunny = meshfit.load_target("mousehead"), meshfit.load_target("bunny")
    goals = bunny.verts[LANDMARKS["bunny"]]
    landmarks = meshfit.Landmarks.of(LANDMARKS["mousehead"], goals)
    settings = meshfit.GaussNewtonSettings(connectivity="fixed", levels=0, register="soft")
    result = meshfit.fit(mouse, bunny, settings, landmarks=landmarks).mesh
    errors = np.linalg.norm(result.verts[LANDMARKS["mousehead"]] - goals, axis=1)
    return [NamedShape("mouse", mouse), NamedShape("bunny", result)], errors / bounding_box_diagonal(bunny.verts)


def main(runs: Path, folder: Path) -> None:
    """Print the errors, and draw the rows."""
    for name, (shapes, errors) in (
        ("metamorphosis-sphere", errors_by_a_sphere(runs)),
        ("metamorphosis", errors_by_registration()),
    ):
        sys.stdout.write(f"{name}: landmarks off by {', '.join(f'{error:.3f}' for error in errors)} of the diagonal\n")
        steps = list(steps_between(aligned(shapes) if name == "metamorphosis" else shapes, 4))
        write_row(steps, folder / f"{name}.png", size=240, up="y", view=_VIEW, edges=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
