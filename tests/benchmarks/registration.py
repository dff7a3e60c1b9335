"""Registration of templates to targets with known correspondence, with other tools and both engines in one table.

python -m tests.benchmarks.registration RUNS PAGE [--only GROUP,...] [--seeds N] [--page-only]

Every pair is an ordinary experiment in the run directory RUNS, so that a stopped benchmark resumes. Where the code of
an engine has changed, remove its folders there: `ours-*`, `large-*`, `turned-*`.
"""

import argparse
import json
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import meshfit
from meshfit.experiment.storage.run_directory import write_atomically
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.io.point_clouds import save_point_cloud
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from tests.benchmarks import registration_page
from tests.benchmarks.registration_pairs import Pair, pairs, slug

_SMALL = (3000, 6000)
"""Numbers of faces of template and target where other tools take part, some of which are slow."""
_ROTATIONS, _TURNED = 20, ("walk", "cow bent by 90°", "galloping horse")
_LANDMARKS = 12
_PEERS = Path(__file__).with_name("registration_peers.py")
_TIME_LIMIT = 600.0
_NEAR_RIGID = {"method": "gauss-newton", "connectivity": "fixed", "levels": 0, "register": "auto"}
_FIRST_ORDER = {
    "method": "first-order",
    "steps": 500,
    "samples": 3000,
    "losses": {"chamfer": 1.0, "normal": 0.0, "edge": 1.0, "laplacian": 0.1, "consistency": 0.01},
    "optimizer": {"name": "sgd", "lr": 1.0, "momentum": 0.9},
}
_OURS: Mapping[str, Any] = {
    "auto": {"fit": _NEAR_RIGID},
    "off": {"fit": _NEAR_RIGID | {"register": "off"}},
    "first-order": {"fit": _FIRST_ORDER},
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path)
    parser.add_argument("page", type=Path)
    parser.add_argument("--only", default="ours,peers,large,turned,cpu", help="groups, in this order")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--variants", default=",".join(_OURS), help="those of ours to run")
    parser.add_argument("--jobs", default="2")
    parser.add_argument("--page-only", action="store_true", help="write the page from what has been run")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    small = [make() for make in pairs(_SMALL)]
    for group in () if options.page_only else options.only.split(","):
        if group == "cpu":
            _measure_cpu(options.runs, small)
            continue
        variants = {name: _OURS[name] for name in options.variants.split(",")} if group == "ours" else None
        chosen = [make() for make in pairs()] if group == "large" else small
        configs = list(_configs(options.runs / "configs", group, chosen, options.seeds, variants))
        meshfit_run = [sys.executable, "-m", "meshfit", "run", *map(str, configs), "--runs", str(options.runs)]
        # Failed trials end with exit code 1, and are rows of the table.
        subprocess.run(
            [*meshfit_run, "--allow-commands", "--jobs", options.jobs], check=False, stdout=subprocess.DEVNULL
        )
    write_atomically(options.page, registration_page.text(options.runs, small, _TURNED).encode())
    return 0


def _configs(
    folder: Path, group: str, chosen: list[Pair], seeds: int, variants: Mapping[str, Any] | None
) -> Iterator[Path]:
    """Write the experiments of a group, and return their files."""
    for pair in chosen:
        if group == "turned" and pair.name not in _TURNED:
            continue
        files = folder / ("large" if group == "large" else "small") / slug(pair.name)
        landmarks = _write(files, pair)
        sweep: dict[str, Any] = {"variants": variants or {"auto": {}}}
        if group == "peers":
            sweep = {"variants": _peer_variants(landmarks)}
        if group == "turned":
            sweep = {"source.mesh": [str(path) for path in _write_turned(files, pair)]}
        config = {
            "targets": [str(files / f"{slug(pair.name)}.ply")],
            "target": {"truth": str(files / "truth.ply")},
            "schemes": ["midpoint"],
            "seeds": list(range(1 if group in ("peers", "turned") else seeds)),
            "normalise": "none",
            "source": {"mesh": str(files / "template.ply"), "levels": 0, "radius": None, "centre": None},
            "fit": _NEAR_RIGID,
            "measure": {"samples": 20_000, "points": 5_000},
            "device": "cpu",
            "sweep": sweep,
        }
        path = folder / f"{group}-{slug(pair.name)}.yaml"
        path.write_text(json.dumps(config, ensure_ascii=False), encoding="utf-8")  # which YAML includes
        yield path


def _write(folder: Path, pair: Pair) -> Path:
    """Write a pair, whose diagonal becomes 1, and return the file of its landmarks."""
    pair, landmarks = _unit(pair), folder / "landmarks.csv"
    if landmarks.exists():  # which is written last
        return landmarks
    folder.mkdir(parents=True, exist_ok=True)
    save_mesh(pair.source, folder / "template.ply")
    save_point_cloud(PointCloud(pair.truth), folder / "truth.ply")
    target = folder / f"{slug(pair.name)}.ply"
    if isinstance(pair.target, Mesh):
        save_mesh(pair.target, target)
    else:
        save_point_cloud(pair.target, target)
    chosen = _spread(pair.source.verts, _LANDMARKS)
    rows = [f"{vert},{x:.6f},{y:.6f},{z:.6f}" for vert, (x, y, z) in zip(chosen, pair.truth[chosen], strict=True)]
    write_atomically(landmarks, "\n".join(["source_vertex,x,y,z", *rows, ""]).encode())
    return landmarks


def _unit(pair: Pair) -> Pair:
    centre, size = (pair.truth.min(axis=0) + pair.truth.max(axis=0)) / 2, pair.diagonal
    source, target = (shape.with_verts((shape.verts - centre) / size) for shape in (pair.source, pair.target))
    return replace(pair, source=source, target=target, truth=(pair.truth - centre) / size)


def _spread(points: np.ndarray, count: int) -> list[int]:
    """Return points that are far from each other, each the farthest from those before."""
    chosen = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())]
    distances = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(distances.argmax()))
        distances = np.minimum(distances, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen


def _write_turned(folder: Path, pair: Pair) -> list[Path]:
    """Write templates in random orientations."""
    pair = _unit(pair)
    rotations = Rotation.random(_ROTATIONS, random_state=np.random.default_rng(0))
    paths = []
    for number, rotation in enumerate(rotations):
        paths.append(folder / f"turned-{number}.ply")
        if not paths[-1].exists():
            save_mesh(pair.source.with_verts(rotation.apply(pair.source.verts.copy())), paths[-1])
    return paths


def _peer_variants(landmarks: Path) -> dict[str, Any]:
    def command(method: str, *given: str) -> dict[str, Any]:
        arguments = [sys.executable, str(_PEERS), method, "{source}", "{target}", "{result}", *given]
        return {"fit": {"method": "external", "command": arguments, "time_limit": _TIME_LIMIT}}

    return {
        "pycpd": command("pycpd"),
        "nricp-amberg": command("nricp-amberg"),
        "nricp-amberg, landmarks": command("nricp-amberg", str(landmarks)),
        "nricp-sumner": command("nricp-sumner"),
        "nricp-sumner, landmarks": command("nricp-sumner", str(landmarks)),
        "meshmonk": command("meshmonk"),
    }


def _measure_cpu(runs: Path, chosen: list[Pair]) -> None:
    """Fit with seed 0 once more, in this process, and record its CPU seconds."""
    for name in _OURS:
        settings = {"auto": meshfit.GaussNewtonSettings, "off": meshfit.GaussNewtonSettings}.get(
            name, meshfit.FirstOrderSettings
        )(**_OURS[name]["fit"])
        for pair in map(_unit, chosen):
            path = runs / "cpu" / f"{slug(pair.name)}-{name}.json"
            if path.exists():
                continue
            start = time.process_time()
            meshfit.fit(pair.source, pair.target, settings, align="none", device="cpu")
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, json.dumps(time.process_time() - start).encode())


if __name__ == "__main__":
    sys.exit(main())
