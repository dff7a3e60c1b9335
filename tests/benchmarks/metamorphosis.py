"""The metamorphosis between mouse and bunny: errors of landmarks, and the pictures of docs/guide/metamorphosis.md.

python -m tests.benchmarks.metamorphosis RUNS FOLDER    # after the runs on that page

RUNS has the run directories of both.
"""

import csv
import sys
from pathlib import Path

import numpy as np

import meshfit
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.report.figures.shape_animation import NamedShape, aligned, shapes_of_trial, steps_between, write_row
from meshfit.report.figures.trial_meshes import read_trial_meshes

_LANDMARKS = Path(__file__).parents[2] / "data" / "landmarks" / "mousehead-bunny.csv"
_VIEW = "-35,15"


def landmark_verts() -> dict[str, list[int]]:
    """Return the vertices of the landmarks on the named targets."""
    with _LANDMARKS.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    sides = {"mousehead": "source_vertex", "bunny": "target_vertex"}
    return {name: [int(row[column]) for row in rows] for name, column in sides.items()}


def errors_by_a_sphere(runs: Path) -> tuple[list[NamedShape], np.ndarray]:
    """Return the results from a sphere, and how far the bunny's landmarks are from the mouse's, as shares."""
    verts_of = landmark_verts()
    folders = {name: next((runs / "accurate-fixed-loop" / name / "loop").glob("seed-0-*")) for name in verts_of}
    shapes = {name: shapes_of_trial(folder)[1] for name, folder in folders.items()}
    places = {
        name: read_trial_meshes(folders[name]).frame.normalise(meshfit.load_target(name)).verts[verts]
        for name, verts in verts_of.items()
    }
    away = np.linalg.norm(shapes["bunny"].mesh.verts[:, None] - places["bunny"], axis=2)
    mouse = shapes["mousehead"].mesh.verts
    errors = np.linalg.norm(mouse[away.argmin(axis=0)] - places["mousehead"], axis=1)
    return [shapes["bunny"], shapes["mousehead"]], errors / bounding_box_diagonal(mouse)


def errors_by_registration(runs: Path) -> tuple[list[NamedShape], np.ndarray]:
    """Return the mouse, the bunny registered from it, and the errors of the landmarks given, as shares."""
    verts_of = landmark_verts()
    folder = next((runs / "metamorphosis" / "bunny" / "loop").glob("seed-0-*"))
    mouse, result = shapes_of_trial(folder)
    bunny = read_trial_meshes(folder).frame.normalise(meshfit.load_target("bunny")).verts
    errors = np.linalg.norm(result.mesh.verts[verts_of["mousehead"]] - bunny[verts_of["bunny"]], axis=1)
    return [NamedShape("mouse", mouse.mesh), NamedShape("bunny", result.mesh)], errors / bounding_box_diagonal(bunny)


def main(runs: Path, folder: Path) -> None:
    """Print the errors, and draw the rows."""
    for name, (shapes, errors) in (
        ("metamorphosis-sphere", errors_by_a_sphere(runs)),
        ("metamorphosis", errors_by_registration(runs)),
    ):
        sys.stdout.write(f"{name}: landmarks off by {', '.join(f'{error:.3f}' for error in errors)} of the diagonal\n")
        steps = list(steps_between(aligned(shapes) if name == "metamorphosis" else shapes, 4))
        write_row(steps, folder / f"{name}.png", size=240, up="y", view=_VIEW, edges=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
