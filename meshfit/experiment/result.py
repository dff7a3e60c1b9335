"""What `result.json` says of a trial."""

import platform
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from meshfit.experiment.plan import SCHEMA_VERSION, Trial
from meshfit.experiment.store import Result, now
from meshfit.fitting.run import FitResult
from meshfit.measuring.measure import Measurement
from meshfit.mesh.frames import Frame

_PACKAGES = ("meshfit", "torch", "numpy", "scipy", "trimesh", "pymeshlab", "pykdtree")


def result_of(trial: Trial, frame: Frame, fitted: FitResult, measured: Measurement, work: Result) -> Result:
    """The record of a complete trial; `work` is what it took."""
    last = fitted.trace.rows[-1] if fitted.trace.rows else ()
    return {
        "schema_version": SCHEMA_VERSION,
        "identity": trial.identity,
        "experiment": trial.experiment,
        **trial.names,
        **measured.to_dict(),
        "fit": {"steps": trial.settings.fit.steps, "device": fitted.device, "final_loss": last[1] if last else None},
        "frame": asdict(frame) | {"normalise": trial.settings.normalise},
        "inputs": dict(trial.inputs),
        "settings": trial.plain_settings,
        **work,
        "finished": now(),
        **_provenance(),
    }


def _provenance() -> Result:
    packages = {name: version(name) for name in _PACKAGES}
    machine: dict[str, Any] = {"system": platform.platform(), "machine": platform.machine(), "host": platform.node()}
    return {"versions": {"python": platform.python_version()} | packages, "platform": machine}
