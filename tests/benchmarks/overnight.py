"""Overhead of many short trials besides fitting and measuring, and the time to find them all complete.

python -m tests.benchmarks.overnight
"""

import sys
import tempfile
import time
from pathlib import Path

from meshfit.config.loading import load_experiment
from meshfit.experiment.plan import plan
from meshfit.experiment.running.scheduler import run_trials
from meshfit.experiment.storage.result import read_results
from meshfit.experiment.storage.run_directory import RunDirectory
from tests.cli.processes import meshfit

_TRIALS, _WORKERS = 300, 2
_CONFIG = f"""\
targets: [bunny]
schemes: [loop]
seeds: {list(range(_TRIALS))}
source: {{levels: 3}}
fit: {{steps: 20, samples: 500}}
measure: {{samples: 1000, points: 1000}}
device: cpu
"""


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="overnight-") as name:
        folder = Path(name)
        (folder / "short.yaml").write_text(_CONFIG, encoding="utf-8")
        trials = plan([load_experiment(str(folder / "short.yaml"))])
        start = time.perf_counter()
        run_trials(trials, RunDirectory(folder / "runs"), jobs=_WORKERS)
        wall = time.perf_counter() - start
        own = sum(sum(result["seconds"].values()) for result in read_results([folder / "runs"]))
        _say(f"{_TRIALS} short trials on {_WORKERS} workers: {wall:.0f} s, of which fits and measurements {own:.0f} s")
        _say(f"besides, for each trial: {(wall * _WORKERS - own) / _TRIALS:.3f} s (asked: at most 0.3 s)")
        start = time.perf_counter()
        meshfit("run", "short.yaml", "-q", folder=folder)
        _say(f"the same command, all complete: {time.perf_counter() - start:.2f} s (asked: at most 3 s)")
    return 0


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
