"""Kill runs at known moments, and check that nothing is lost: signals, full disks, lost folders, clusters, locales.

python -m tests.kills WORK

WORK/done.txt lists the chains of kills that have passed; the same command again runs the others. Linux only.
"""

import argparse
import sys
import time
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

from tests.kills import cluster, folders, signals
from tests.kills.experiments import prepare_process, undisturbed
from tests.kills.locales import locales

Chain = signals.Chain | folders.Chain | cluster.Chain
_DISTURB = {signals.Chain: signals.disturb, folders.Chain: folders.disturb, cluster.Chain: cluster.disturb}


def all_chains(work: Path, rotation: int = 0) -> list[Chain]:
    """All chains of kills."""
    named = {name: {"LC_ALL": name, "LOCPATH": str(work / "locales")} for name in locales(work / "locales")}
    return [*signals.chains(named, rotation), *folders.chains(), *cluster.chains()]


def main(work: Path, rotation: int, wanted: str) -> int:
    """Run the chains that have not passed, and return 1 if one fails."""
    work.mkdir(parents=True, exist_ok=True)
    prepare_process()
    done = work / "done.txt"
    done.touch()
    place = work / time.strftime("%Y%m%dT%H%M%S")

    @cache
    def reference(engine: str) -> Mapping[int, str]:
        return undisturbed(place / f"undisturbed-{engine}", engine, signals.CHAIN)

    failed = kills = 0
    for number, chain in enumerate(all_chains(work, rotation)):
        name = f"{number}, rotation {rotation}: {chain}"
        if wanted not in name:
            continue
        if name not in done.read_text(encoding="utf-8").splitlines():
            try:
                _DISTURB[type(chain)](chain, place / str(number), reference(chain.engine), _report(name))
            except AssertionError as error:
                failed += 1
                _write(f"FAILED  {name}: {error}")
                continue
            with done.open("a", encoding="utf-8") as file:
                file.write(f"{name}\n")
        kills += len(chain.kills)
    _write(f"{kills} kills: nothing lost, same bytes as undisturbed" if not failed else f"{failed} chains failed")
    return 1 if failed else 0


def _report(name: str) -> Callable[[str], None]:
    return lambda text: _write(f"{name}: {text}")


def _write(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path, help="folder to work in; what failed stays there")
    parser.add_argument("--rotation", type=int, default=0, help="spread the kills over engines and workers differently")
    parser.add_argument("--only", default="", help="run the chains whose names contain this")
    arguments = parser.parse_args()
    sys.exit(main(arguments.work.resolve(), arguments.rotation, arguments.only))
