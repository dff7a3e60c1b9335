"""Thousands of results with random numbers, as runs write them, to time the table command on."""

import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from meshfit.config.experiment import ExperimentSettings
from meshfit.measuring.metrics import METRICS
from meshfit.settings import override

_TARGETS = ("bunny", "mousehead", "cow", "bone", "airplane")
_SCHEMES = ("midpoint", "loop", "interp-loop", "butterfly", "modified-butterfly", "sqrt3")
_EDGE_WEIGHTS = tuple(round(0.1 * 1.2**power, 4) for power in range(20))
_SEEDS = range(5)


# What else a result holds, and no table looks at.
_REST: dict[str, Any] = {
    "fit": {"steps": 2000, "device": "cpu", "final_loss": 0.0123456789},
    "frame": {"centre": [0.123456789] * 3, "scale": 0.123456789, "normalise": "tutorial"},
    "seconds": {"fit": 12.3456789, "measure": 1.23456789},
    "peak_memory_mb": 421.904384,
    "warnings": [],
    "versions": dict.fromkeys(("python", "meshfit", "torch", "numpy", "scipy", "pymeshlab"), "1.23.4"),
    "platform": {"system": "Linux-6.1-x86_64-with-glibc2.36", "machine": "x86_64"},
}


def write_results(root: Path) -> None:
    """Write the results of a sweep, 3,000 in all."""
    generator = np.random.default_rng(0)
    for result in (result for weight in _EDGE_WEIGHTS for result in _results(weight, generator)):
        trial = f"seed-{result['seed']}-{result['identity'][:10]}"
        folder = root / result["experiment"] / result["target"] / result["scheme"] / trial
        folder.mkdir(parents=True)
        (folder / "result.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
        for other in ("config.yaml", "trace.csv", "source.ply", "result.ply"):
            (folder / other).touch()


def _results(weight: float, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    settings = override(ExperimentSettings(), {"fit": {"losses": {"edge": weight}}}).model_dump(mode="json")
    for target, scheme, seed in itertools.product(_TARGETS, _SCHEMES, _SEEDS):
        figures: dict[str, Any] = {}
        for name in METRICS:
            group, _, figure = name.partition(".")
            figures.setdefault(group, {})[figure] = 0.1 + 0.01 * float(generator.normal())
        yield {
            "schema_version": 2,
            "identity": generator.bytes(32).hex(),
            "experiment": "sweep",
            "target": target,
            "target_title": target,
            "scheme": scheme,
            "seed": seed,
            **figures,
            "inputs": {"target": "0" * 64},
            "settings": settings | {"targets": [target], "schemes": [scheme], "seeds": [seed]},
            **_REST,
        }
