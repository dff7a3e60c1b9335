"""Kill runs at random moments, again and again, and check that nothing is lost.

python -m tests.cli.kills --kills 100
"""

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from tests.cli.processes import contents, meshfit, start, workers_of
from tests.small import CONFIG, config_file

KEPT = ("result.ply", "trace.csv", "source.ply")
FITS = CONFIG.replace("steps: 20", "steps: 1200").replace("seeds: [0, 1]", "seeds: [0, 1, 2, 3]")
LONGEST = 9.0


def kill(process, rng):
    """SIGKILL to the run and its workers, to the run alone, or to one of its workers; which is told."""
    workers = workers_of(process.pid)
    what = rng.choice(["all", "run", "worker"] if workers else ["all", "run"])
    with suppress(ProcessLookupError):
        if what == "all":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            os.kill(process.pid if what == "run" else rng.choice(workers), signal.SIGKILL)
    return what


def disturb(folder, kills, rng, config):
    """Run a config in a folder and kill it until it is complete, or so many times; how many it took is returned."""
    done, kept = 0, {}
    while done < kills:
        process = start("run", config, "-q", folder=folder)
        until = time.monotonic() + rng.uniform(0.2, LONGEST)
        while process.poll() is None and time.monotonic() < until:
            time.sleep(0.01)
        if process.poll() is None:
            what, done = kill(process, rng), done + 1
            if what == "worker":
                process.communicate(timeout=300)
        process.communicate(timeout=300)
        now = contents(folder / "runs", "result.json")
        lost = [path for path, content in kept.items() if now.get(path) != content]
        assert not lost, f"lost or changed: {lost}"
        kept = now
        if len(kept) == 8:
            break
    return done


def main(kills, seed):
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        quiet = Path(name, "quiet")
        quiet.mkdir()
        table, _ = meshfit("run", config_file(quiet, FITS), "-q", folder=quiet)
        done = rounds = 0
        while done < kills:
            rounds += 1
            folder = Path(name, f"round-{rounds}")
            folder.mkdir()
            config = config_file(folder, FITS)
            done += disturb(folder, kills - done, rng, config)
            found, _ = meshfit("run", config, "-q", folder=folder)
            assert found == table, found
            assert contents(folder / "runs", *KEPT) == contents(quiet / "runs", *KEPT)
            left = {path.name for path in (folder / "runs").rglob("*") if path.is_file()}
            halves = sum(name.startswith(".") and name != ".lock" for name in left)
            sys.stdout.write(f"{done} kills: same table, same bytes; {halves} half-written files, none taken\n")
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    sys.exit(main(arguments.kills, arguments.seed))
