"""The trials of the study of Table 1: their settings, and their distances as different people would measure them."""

import json
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pymeshlab
from pymeshlab import PercentageValue

from meshfit.errors import MeshfitWarning
from meshfit.experiment.storage.result import read_results
from meshfit.experiment.storage.run_directory import Result, write_atomically
from meshfit.mesh.any_target import require_mesh
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.targets import load_target
from meshfit.report.tables.grouping import shared_settings
from meshfit.report.tables.paper_numbers import READINGS

CELLS = (("bunny", "loop"), ("bunny", "interp-loop"), ("mousehead", "loop"), ("mousehead", "interp-loop"))
"""The cells of the paper's table: target and scheme."""
EXACT = "both ways"
MEASURES = (EXACT, "result → target", "target → result", "MeshLab, result's vertices", "MeshLab, target's vertices")
"""Distances that "Hausdorff distance" may stand for; the last two are those of MeshLab's filter with its defaults."""
FRAME, DIAGONAL = "frame", "diagonal"
"""Units: the lengths of the normalised frame, or the diagonal of the target's bounding box."""
_MESHLAB = "meshlab-hausdorff.json"

Distances = tuple[float, float, float, float]
"""One for each of `CELLS`."""


@dataclass(frozen=True)
class Point:
    """One point of a sample: settings, and a distance for each cell, measure and unit.

    Attributes:
        settings: what its four trials share, by dotted key.
        variant: its name in the sweep.
        seed: of the samples of the fits.
        distances: by measure and unit.
        sizes: of the sources, relative to the target, by area: 2 for one whose area is four times the target's.
        folders: of its trials, in the order of `CELLS`.
    """

    settings: Mapping[str, Any]
    variant: str
    seed: int
    distances: Mapping[tuple[str, str], Distances]
    sizes: Distances
    folders: tuple[Path, ...]

    @property
    def source(self) -> str:
        """The kind of its initial mesh."""
        mesh = str(self.settings["source.mesh"])
        if mesh == "target":
            return "coarse target"
        if self.settings["source.project"] == "sphere":
            return "ellipsoid" if self.settings["source.align"] == "box" else "icosphere"
        return mesh


def read_points(folder: Path) -> list[Point]:
    """Return the points of an experiment with a trial in each cell, in the order of their settings; [] without any."""
    if not folder.is_dir():
        return []
    found: dict[tuple[str, int], dict[tuple[str, str], Result]] = {}
    for result in read_results([folder]):
        key = json.dumps(shared_settings(result), sort_keys=True), int(result["seed"])
        found.setdefault(key, {})[result["target"], result["scheme"]] = result
    points = []
    for (text, seed), cells in sorted(found.items()):
        if set(CELLS) <= cells.keys():
            columns = [dict(_distances(cells[cell])) for cell in CELLS]
            distances = {key: _of_cells([column[key] for column in columns]) for key in columns[0]}
            folders = tuple(Path(cells[cell]["folder"]) for cell in CELLS)
            sizes = _of_cells([_relative_size(cells[cell]) for cell in CELLS])
            points.append(Point(json.loads(text), str(cells[CELLS[0]]["variant"]), seed, distances, sizes, folders))
    return points


def far_from_table(distances: Distances, reading: str) -> float:
    """Return the largest factor by which a distance differs from the paper's number."""
    return max(max(x / y, y / x) for x, y in zip(distances, paper(reading), strict=True))


def paper(reading: str) -> Distances:
    """Return the paper's numbers."""
    return _of_cells([READINGS[reading][cell] for cell in CELLS])


def _of_cells(values: Sequence[float]) -> Distances:
    first, second, third, fourth = values
    return first, second, third, fourth


def _relative_size(result: Result) -> float:
    return math.sqrt(result["source"]["area"] * result["frame"]["scale"] ** 2 / _target_area(str(result["target"])))


@cache
def _target_area(target: str) -> float:
    return float(face_areas(require_mesh(load_target(target), target)).sum())


def _distances(result: Result) -> Iterator[tuple[tuple[str, str], float]]:
    hausdorff = result["hausdorff"]
    to_share = hausdorff["percent_of_diagonal"] / 100 / hausdorff["symmetric"]
    exact = (hausdorff["symmetric"], hausdorff["forward"], hausdorff["backward"])
    for measure, value in zip(MEASURES, (*exact, *_by_meshlab(result)), strict=True):
        yield (measure, FRAME), value
        yield (measure, DIAGONAL), value * to_share


def _by_meshlab(result: Result) -> tuple[float, float]:
    """Return the distances of MeshLab's filter with its defaults, in the normalised frame; kept beside the result."""
    path = Path(result["folder"]) / _MESHLAB
    if path.is_file():
        kept = json.loads(path.read_text())
        if kept["identity"] == result["identity"]:
            return float(kept["result sampled"]), float(kept["target sampled"])
    target = require_mesh(load_target(str(result["target"])), str(result["target"]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)  # results may be inside out
        fitted = load_mesh(path.with_name("result.ply"))
    scale = result["frame"]["scale"]
    values = [_filter(sampled, other) / scale for sampled, other in ((fitted, target), (target, fitted))]
    record = {"identity": result["identity"], "result sampled": values[0], "target sampled": values[1]}
    write_atomically(path, json.dumps(record))
    return values[0], values[1]


def _filter(sampled: Mesh, target: Mesh) -> float:
    """Return the maximum that MeshLab's filter prints: over the vertices of one mesh, within half a diagonal."""
    meshes = pymeshlab.MeshSet(verbose=False)
    for mesh in (sampled, target):
        meshes.add_mesh(pymeshlab.Mesh(mesh.verts, mesh.faces))
    found = meshes.get_hausdorff_distance(
        sampledmesh=0,
        targetmesh=1,
        savesample=False,
        samplevert=True,
        sampleedge=False,
        samplefauxedge=False,
        sampleface=False,
        samplenum=sampled.num_verts,
        maxdist=PercentageValue(50),
    )
    return float(found["max"])
