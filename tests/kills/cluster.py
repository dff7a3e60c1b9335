"""Workers and the scheduler of a Dask cluster that are killed and stopped in the middle of a trial."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from tests.cli.dask_cluster import running_cluster
from tests.cli.processes import wait_until
from tests.kills.experiments import FITS, Experiment
from tests.kills.signals import Kill, check_kept, check_phase, finish, named, state_of, wait_for

SILENT = 5
"""Seconds after which the scheduler gives up a worker that is silent."""
_SECONDS_STOPPED = 2.0
_LONGEST = 60.0
_PHASES = ("fitting", "measuring", "renaming")


@dataclass(frozen=True)
class Chain:
    """Kills of parts of a cluster, in one run directory, to which its workers write or not."""

    engine: str
    transfer: str
    kills: tuple[Kill, ...]

    def __str__(self) -> str:
        return f"{self.engine}, cluster with files {self.transfer}"


def chains() -> list[Chain]:
    """Kills of workers, of schedulers and of runs, in both engines, with both transfers of files."""
    kills = [
        *(Kill(*each) for each in product(_PHASES, ["worker"], ["KILL", "TERM", "SEGV", "STOP"])),
        *(Kill(*each) for each in product(_PHASES[:2], ["scheduler"], ["KILL", "STOP"])),
        *(Kill(*each) for each in product(_PHASES[:2], ["run"], ["KILL", "INT", "TERM", "STOP"])),
    ]
    kinds = list(product(FITS, ("shared", "returned")))
    found = []
    for index, (engine, transfer) in enumerate(kinds):
        share = kills[(index + index // 2) % 2 :: 2]
        found += [Chain(engine, transfer, tuple(share[start : start + 10])) for start in range(0, len(share), 10)]
    return found


def disturb(chain: Chain, folder: Path, reference: Mapping[int, str], report: Callable[[str], None]) -> None:
    """Disturb a cluster again and again; a scheduler that was killed is replaced, with its workers.

    Raises:
        AssertionError: saying which kill did what.
    """
    experiment = Experiment(folder, chain.engine)
    resumed, kept = set[int](), dict[int, str]()
    variables = experiment.environment | {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": f"{SILENT}s"}
    with ExitStack() as clusters:
        file, processes = clusters.enter_context(running_cluster(folder, variables))
        for seed, kill in enumerate(chain.kills):
            with named(kill):
                options = ("--cluster", file, "--transfer", chain.transfer)
                experiment.pause.disarm()
                process = experiment.start([*range(max(0, seed - 1), seed), seed], *options)
                experiment.pause.arm(kill.phase, seed)
                resumes = hit(kill, process, experiment, seed, processes[0].pid, shared=chain.transfer == "shared")
                if resumes:
                    resumed.add(seed)
                if kill.victim == "scheduler" and kill.signal == "KILL":
                    clusters.close()
                    file, processes = clusters.enter_context(running_cluster(folder, variables))
                kept = check_kept(experiment, kept, reference, resumed)
            report(str(kill))
    experiment.pause.disarm()
    finish(experiment, len(chain.kills), reference, resumed)


def hit(
    kill: Kill, process: subprocess.Popen[str], experiment: Experiment, seed: int, scheduler: int, *, shared: bool
) -> bool:
    """Deliver a kill once its phase is reached; return whether the trial has to resume from a checkpoint."""
    try:
        wait_until(lambda: experiment.pause.process is not None, process)
        worker = experiment.pause.process
        assert worker is not None
        if shared:
            check_phase(kill.phase, experiment, seed)
        victim = {"run": process.pid, "worker": worker, "scheduler": scheduler}[kill.victim]
        os.kill(victim, kill.number)
        start = time.monotonic()
        if kill.signal == "STOP" and kill.victim != "worker":
            wait_for(lambda: state_of(victim) == "T", "the victim does not stop")
            time.sleep(_SECONDS_STOPPED)
            os.kill(victim, signal.SIGCONT)
        elif kill.signal in ("KILL", "SEGV"):
            wait_for(lambda: state_of(victim) in ("Z", ""), "the victim lives on")
        if kill.signal != "STOP" or kill.victim != "worker":
            time.sleep(0.5)
            experiment.pause.release()
        out, err = process.communicate(timeout=300)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    code = _exit_code(kill)
    assert process.returncode == code, f"exit code {process.returncode}, not {code}\n{out}{err}"
    assert "Traceback" not in out + err, err
    assert len(err.splitlines()) <= 1, err
    seconds = time.monotonic() - start
    assert seconds < _LONGEST, f"its trial went to another worker only after {seconds:.0f} s"
    if code == 0:
        assert (experiment.trial(seed) / "result.json").is_file()
        is_lost = kill.victim == "worker" and kill.signal != "TERM"
        if shared and is_lost:
            assert experiment.log(seed).count("started on") == 2, experiment.log(seed)
            return True
        return False
    if kill.victim == "run" and kill.signal != "INT" and shared:  # its worker goes on until it notices
        wait_for(lambda: not (experiment.trial(seed) / "progress.json").exists(), "the worker goes on without end")
    checkpoint = (experiment.trial(seed) / "checkpoint.pt").is_file()
    return checkpoint and not (experiment.trial(seed) / "result.json").is_file()


def _exit_code(kill: Kill) -> int:
    if kill.victim == "scheduler":
        return 2 if kill.signal == "KILL" else 0
    return kill.exit_code
