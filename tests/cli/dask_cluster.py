"""A real Dask cluster on loopback: a scheduler and two workers, whose output is kept in files."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.cli.processes import ENVIRONMENT, wait_until

WORKERS = 2


@contextmanager
def running_cluster(
    folder: Path, environment: Mapping[str, str] | None = None
) -> Iterator[tuple[Path, list[subprocess.Popen[bytes]]]]:
    """Yield the file of a scheduler, and the processes: the scheduler, and the nannies of its workers.

    Args:
        folder: for its files.
        environment: additions to the environment of the processes.
    """
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    variables = ENVIRONMENT | {"TMPDIR": str(folder)} | dict(environment or {})
    options = ["--no-dashboard", "--scheduler-file", str(file)]
    processes = [_dask(folder, variables, "scheduler", "--host", "127.0.0.1", "--port", str(port), *options)]
    try:
        wait_until(file.is_file, processes[0])
        options += ["--local-directory", str(folder), "--nthreads", "1"]
        processes += [_dask(folder, variables, "worker", *options) for _ in range(WORKERS)]
        yield file, processes
    finally:
        for process in processes:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _dask(folder: Path, environment: Mapping[str, str], *arguments: str) -> subprocess.Popen[bytes]:
    with (folder / f"dask-{arguments[0]}.log").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *arguments],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
