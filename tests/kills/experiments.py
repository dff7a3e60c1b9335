"""Tiny experiments of both engines, the processes that run them, and their results, for the kill harness."""

import ctypes
import hashlib
import json
import os
import resource
import subprocess
from collections.abc import Iterable, Mapping
from pathlib import Path

from tests.cli.processes import start
from tests.small import ellipsoid

PAUSES = Path(__file__).with_name("pauses")
FITS = {
    "first-order": "{steps: 20, samples: 100, trace_every: 5}",
    "gauss-newton": "{method: gauss-newton, connectivity: fixed, levels: 1, coarse_steps: 4, level_steps: 3,"
    " last_steps: 3, tries: 1}",
}
CONFIG = """\
targets: [ellipsoid.ply]
schemes: [loop]
source: {{mesh: octahedron, levels: 2}}
fit: {fit}
measure: {{samples: 500, points: 500}}
retries: 9
"""
VOLATILE = ("seconds", "peak_memory_mb", "finished", "platform")
"""Entries of a result that differ from run to run."""
_PR_CAPBSET_DROP, _CAP_DAC_OVERRIDE, _CAP_DAC_READ_SEARCH = 24, 1, 2
_FILES = ("source.ply", "result.ply", "trace.csv", "config.yaml", "correspondence.csv")


class Experiment:
    """An experiment in a folder of its own, of as many trials as are asked for, each with its seed.

    Args:
        folder: a new folder.
        engine: one of `FITS`.
        variables: additions to the environment of its processes.
        runs: the run directory; `runs` in the folder by default.
    """

    def __init__(
        self, folder: Path, engine: str, variables: Mapping[str, str] | None = None, runs: Path | None = None
    ) -> None:
        folder.mkdir(parents=True)
        self.folder, self.runs = folder, runs or folder / "runs"
        ellipsoid(folder)
        (folder / "small.yaml").write_text(CONFIG.format(fit=FITS[engine]), encoding="utf-8")
        self.pause = Pause(folder / "pause")
        self.environment = self.pause.environment | dict(variables or {})

    def start(self, seeds: Iterable[int], *options: object) -> subprocess.Popen[str]:
        """Start a run of the trials of some seeds."""
        arguments = ("run", "small.yaml", "-q", "--runs", self.runs, "--set", f"seeds={list(seeds)}", *options)
        return start(*arguments, folder=self.folder, environment=self.environment)

    def trial(self, seed: int) -> Path:
        """The folder of a trial, which may not exist yet."""
        return next(self.runs.glob(f"*/*/*/seed-{seed}-*"), self.runs / "none")

    def log(self, seed: int) -> str:
        path = self.trial(seed) / "trial.log"
        return path.read_text(encoding="utf-8") if path.is_file() else ""

    def progress(self, seed: int) -> dict[str, object]:
        return json.loads((self.trial(seed) / "progress.json").read_text(encoding="utf-8"))

    def results(self) -> dict[int, str]:
        """A digest of all files of each complete trial, by seed."""
        complete = (path.parent for path in self.runs.glob("*/*/*/seed-*/result.json"))
        return {int(folder.name.split("-")[1]): digest(folder, self.folder) for folder in complete}

    def half_written(self, seed: int | str = "*") -> list[str]:
        """The names of the files in the folder of a trial, or of all, that writers have not finished."""
        names = (path.name for path in self.runs.glob(f"*/*/*/seed-{seed}-*/.*"))
        return sorted(name for name in names if name != ".lock")


class Pause:
    """A pause in the processes of an experiment, at a phase of a trial."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.environment = {
            "MESHFIT_TEST_PAUSE": str(path),
            "PYTHONPATH": os.pathsep.join([str(PAUSES), *filter(None, [os.environ.get("PYTHONPATH")])]),
        }

    def arm(self, phase: str, seed: int) -> None:
        for name in (".paused", ".go"):
            self.path.with_name(self.path.name + name).unlink(missing_ok=True)
        self.path.write_text(f"{phase} {seed}", encoding="ascii")

    def disarm(self) -> None:
        self.path.unlink(missing_ok=True)

    @property
    def process(self) -> int | None:
        """The process that has paused; None before."""
        path = self.path.with_name(f"{self.path.name}.paused")
        return int(path.read_text(encoding="ascii")) if path.is_file() else None

    def release(self) -> None:
        self.path.with_name(f"{self.path.name}.go").touch()


def digest(folder: Path, place: Path) -> str:
    """A digest of the files of a complete trial, without what differs from run to run, and from place to place."""
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    kept = {key: value for key, value in result.items() if key not in VOLATILE}
    parts = [json.dumps(kept, sort_keys=True).encode()]
    parts += [(folder / name).read_bytes() for name in _FILES if (folder / name).is_file()]
    return hashlib.sha256(b"\0".join(parts).replace(str(place).encode(), b"")).hexdigest()


def undisturbed(folder: Path, engine: str, trials: int) -> dict[int, str]:
    """The digests of trials that nobody disturbs."""
    experiment = Experiment(folder, engine)
    process = experiment.start(range(trials), "-j", 1)
    _, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    return experiment.results()


def prepare_process() -> None:
    """Have processes that crash leave no files, and those of the superuser heed the permissions of files."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if os.geteuid() == 0:
        for capability in (_CAP_DAC_OVERRIDE, _CAP_DAC_READ_SEARCH):
            ctypes.CDLL(None, use_errno=True).prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0)
