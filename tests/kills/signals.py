"""Signals to a run, to one of its workers and to its process group, at each phase of a trial.

A chain is a few kills in one run directory. Kill number k hits the trial of seed k. The next run takes up that trial
and is killed in the trial of seed k + 1, and the last one completes all.
"""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import cycle, product
from pathlib import Path

from tests.cli.processes import wait_until, workers_of
from tests.kills.experiments import FITS, Experiment

SIGNALS = ("TERM", "HUP", "INT", "QUIT", "ABRT", "SEGV", "STOP", "KILL")
VICTIMS = ("run", "worker", "group")
BEFORE = ("planning", "starting", "importing")
"""Phases before a trial has begun."""
PHASES = {
    **dict.fromkeys(BEFORE, None),
    "fitting": "fitting",
    "checkpoint-writing": "fitting",
    "checkpoint-renaming": "fitting",
    "measuring": "measuring",
    "writing": "measuring",
    "renaming": "measuring",
    "finishing": "measuring",
}
"""Phases, each with the one that `progress.json` states then."""
CHAIN = 10
"""Number of kills in a chain."""
_SECONDS_STOPPED = 0.3


@dataclass(frozen=True)
class Kill:
    """A signal to a victim at a phase."""

    phase: str
    victim: str
    signal: str

    def __str__(self) -> str:
        return f"{self.signal} to the {self.victim} while {self.phase}"

    @property
    def number(self) -> signal.Signals:
        return signal.Signals[f"SIG{self.signal}"]

    @property
    def exit_code(self) -> int:
        """The documented exit code of a run that gets it."""
        if self.victim == "worker" or self.signal == "STOP":
            return 0
        return 130 if self.signal == "INT" else -self.number

    @property
    def is_deadly(self) -> bool:
        """Whether the victim dies of it at once."""
        return self.signal not in ("INT", "STOP")


@dataclass(frozen=True)
class Chain:
    """Kills in one run directory."""

    engine: str
    workers: int
    kills: tuple[Kill, ...]
    variables: Mapping[str, str]

    def __str__(self) -> str:
        language = "".join(f", LC_ALL={self.variables[name]}" for name in ("LC_ALL",) if name in self.variables)
        return f"{self.engine}, {self.workers} worker{'s' * (self.workers > 1)}{language}"


def kills_of(rotation: int = 0) -> list[Kill]:
    """Every signal to every victim at every phase; a worker does not plan."""
    found = [Kill(*each) for each in product(PHASES, VICTIMS, SIGNALS) if each[:2] != ("planning", "worker")]
    return found[rotation:] + found[:rotation]


def chains(locales: Mapping[str, Mapping[str, str]], rotation: int = 0) -> list[Chain]:
    """Chains of all kills, spread over engines and workers, and a few more in each of some locales.

    Args:
        locales: environment variables by the name of a locale.
        rotation: number of kills by which the others are shifted.
    """
    kills = kills_of(rotation)
    kinds = list(product(FITS, (1, 2)))
    found = []
    for index, (engine, workers) in enumerate(kinds):
        # The kinds take turns, and begin in turn with each victim, so that each of them gets every signal.
        share = [kill for place, kill in enumerate(kills) if (place + place // len(SIGNALS)) % len(kinds) == index]
        found += [Chain(engine, workers, tuple(part), {}) for part in _parts(share)]
    some = tuple(
        Kill(phase, victim, "KILL") for phase, victim in product(("fitting", "renaming"), ("run", "worker", "group"))
    )
    engines = cycle(FITS)
    return found + [Chain(next(engines), 1, some, variables) for variables in locales.values()]


def _parts(kills: list[Kill]) -> Iterator[list[Kill]]:
    for start in range(0, len(kills), CHAIN):
        yield kills[start : start + CHAIN]


def disturb(chain: Chain, folder: Path, reference: Mapping[int, str], report: Callable[[str], None]) -> None:
    """Run a chain of kills, and check after each that nothing is lost, and at the end that all is as undisturbed.

    Raises:
        AssertionError: saying which kill did what.
    """
    experiment = Experiment(folder, chain.engine, chain.variables)
    resumed, kept = set[int](), dict[int, str]()
    for seed, kill in enumerate(chain.kills):
        with named(kill):
            process = experiment.start([*range(max(0, seed - 1), seed), seed], "-j", chain.workers)
            experiment.pause.arm(kill.phase, seed)
            resumed |= hit(kill, process, experiment, seed)
            kept = check_kept(experiment, kept, reference, resumed)
        report(str(kill))
    experiment.pause.disarm()
    finish(experiment, len(chain.kills), reference, resumed)


def hit(kill: Kill, process: subprocess.Popen[str], experiment: Experiment, seed: int) -> set[int]:
    """Deliver a kill once its phase is reached; its seed is returned if a checkpoint has to be resumed from."""
    try:
        wait_until(lambda: experiment.pause.process is not None, process)
        paused = experiment.pause.process
        assert paused is not None
        check_phase(kill.phase, experiment, seed)
        before = (experiment.trial(seed) / "checkpoint.pt").is_file()
        workers = workers_of(process.pid)
        victims = {"run": [process.pid], "worker": [paused], "group": [process.pid, paused]}[kill.victim]
        if kill.victim == "group":
            os.killpg(process.pid, kill.number)
        else:
            os.kill(victims[0], kill.number)
        if kill.signal == "STOP":
            _check_stopped(victims)
            _send(kill, process, victims, signal.SIGCONT)
        elif kill.signal == "INT":
            time.sleep(_SECONDS_STOPPED)
            assert state_of(paused) not in ("Z", ""), "the worker died of Ctrl-C"
        else:
            if kill.phase != "starting":  # from then on, workers end with the run
                victims = [*victims, paused]
            wait_for(lambda: all(state_of(pid) in ("Z", "") for pid in victims), "the victim lives on")
        experiment.pause.release()
        out, err = process.communicate(timeout=300)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert process.returncode == kill.exit_code, f"exit code {process.returncode}, not {kill.exit_code}\n{out}{err}"
    assert "Traceback" not in out + err, err
    err = without_leaks(err)
    assert len(err.splitlines()) <= 1, err
    assert kill.exit_code != 130 or err.startswith("interrupted"), err
    wait_for(lambda: all(state_of(pid) in ("Z", "") for pid in (paused, *workers)), "a worker outlives the run")
    has_result = (experiment.trial(seed) / "result.json").is_file()
    if kill.phase == "finishing":
        assert has_result
        return set()
    if kill.exit_code == 0:
        assert has_result
        if kill.is_deadly:
            assert kill.phase in BEFORE or "killed at step" in experiment.log(seed), experiment.log(seed)
            return {seed} if before else set()
        return set()
    assert kill.signal == "INT" or not has_result
    return {seed} if not has_result and (experiment.trial(seed) / "checkpoint.pt").is_file() else set()


def without_leaks(err: str) -> str:
    """Drop what the tracker of Python writes of semaphores, which it removes itself after the death of a run."""
    lines = [line for line in err.splitlines() if "resource_tracker" not in line]
    return "\n".join(lines)


def check_phase(phase: str, experiment: Experiment, seed: int) -> None:
    """Check that a trial is in the phase that is meant."""
    if PHASES[phase] is None:
        assert not experiment.log(seed), "the trial has begun"
        return
    progress = experiment.progress(seed)
    assert progress["phase"] == PHASES[phase], progress
    assert progress["pid"] == experiment.pause.process or phase in BEFORE, progress
    assert (experiment.trial(seed) / "result.json").is_file() == (phase == "finishing")
    assert (experiment.trial(seed) / "checkpoint.pt").is_file()
    parts = [name for name in experiment.half_written(seed) if name.startswith(".result") or "checkpoint" in name]
    assert bool(parts) == (phase in ("checkpoint-writing", "checkpoint-renaming", "writing", "renaming")), parts


def check_kept(
    experiment: Experiment, kept: Mapping[int, str], reference: Mapping[int, str], resumed: set[int]
) -> dict[int, str]:
    """Check that complete trials are still there and as undisturbed, and that those with checkpoints resumed."""
    results = experiment.results()
    lost = [seed for seed in kept if results.get(seed) != kept[seed]]
    assert not lost, f"lost or changed: {lost}"
    other = [seed for seed in results if results[seed] != reference[seed]]
    assert not other, f"other bytes than undisturbed: {other}"
    for seed in resumed & results.keys():
        assert "resuming from a checkpoint" in experiment.log(seed), experiment.log(seed)
    return results


def finish(experiment: Experiment, trials: int, reference: Mapping[int, str], resumed: set[int]) -> None:
    """Run to the end, and compare with what is undisturbed."""
    process = experiment.start(range(trials))
    out, err = process.communicate(timeout=600)
    assert (process.returncode, err) == (0, ""), out + err
    results = check_kept(experiment, {}, reference, resumed)
    assert set(results) == set(range(trials)), results
    assert not experiment.half_written(), experiment.half_written()


def _send(kill: Kill, process: subprocess.Popen[str], victims: list[int], number: signal.Signals) -> None:
    if kill.victim == "group":
        os.killpg(process.pid, number)
    else:
        os.kill(victims[0], number)


def _check_stopped(victims: list[int]) -> None:
    wait_for(lambda: all(state_of(pid) == "T" for pid in victims), "the victim does not stop")
    time.sleep(_SECONDS_STOPPED)
    assert all(state_of(pid) == "T" for pid in victims)


def state_of(pid: int) -> str:
    """The state of a process, as in `ps`; empty where there is none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""


def wait_for(condition: Callable[[], bool], otherwise: str, seconds: float = 120) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, otherwise
        time.sleep(0.02)


@contextmanager
def named(kill: object) -> Iterator[None]:
    """Name the kill in errors that are raised within the block."""
    try:
        yield
    except (AssertionError, subprocess.TimeoutExpired) as error:
        raise AssertionError(f"{kill}: {error}") from error
