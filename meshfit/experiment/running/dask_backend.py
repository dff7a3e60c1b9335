"""Workers of an existing Dask cluster (the extra `dask`)."""

import importlib
import logging
import threading
import uuid
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from meshfit.errors import ClusterError, ConfigError, MeshfitWarning
from meshfit.experiment.results_version import RESULTS_VERSION
from meshfit.experiment.running.backends import Remote, Transfer
from meshfit.experiment.running.worker import CancellationFlag, Channel, Files

_CONNECT_SECONDS = 8
_WORKER_SECONDS = 300
_GPU = "GPU"
SILENT_SECONDS = 120.0
"""Seconds without a sign of life after which a worker is given up."""
_SECONDS_BETWEEN_LOOKS = 5.0
_DEFAULT_TTL = 300.0
"""The scheduler's `worker-ttl` where none is set."""

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class CancellationEvent:
    """A cancellation flag that the scheduler of the cluster holds.

    Attributes:
        name: its name on the scheduler.
        client: the client of the sender; it does not travel.
    """

    name: str
    client: Any = field(default=None, compare=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Send the name only."""
        return type(self), (self.name,)

    def set(self) -> None:
        """Ask workers to stop."""
        self._event().set()

    def is_set(self) -> bool:
        """Whether workers are asked to stop."""
        return bool(self._event().is_set())

    def clear(self) -> None:
        """Remove the flag."""
        self._event().clear()

    def _event(self) -> Any:  # noqa: ANN401  distributed is optional
        return importlib.import_module("distributed").Event(self.name, client=self.client)


@dataclass(frozen=True)
class EventChannel:
    """A channel of events on a topic of the scheduler."""

    topic: str

    def send(self, trial: int, files: Files) -> None:
        """Send the present content of files of a trial; they come with its result if that fails."""
        with suppress(OSError, RuntimeError, TypeError, ValueError):
            worker = importlib.import_module("distributed").get_worker()
            worker.log_event(self.topic, {"trial": trial, "files": dict(files)})


class DaskRemote(Remote):
    """Workers of a Dask cluster; Dask passes a trial whose worker is lost to another one.

    A worker that is silent, because it is stopped or cut off, counts as lost after a while: see `silent_after`.
    """

    def __init__(self, address: str, *, transfer: Transfer = "auto", silent_after: float = SILENT_SECONDS) -> None:
        """Connect to a scheduler, and wait until it has a worker.

        Args:
            address: an address such as `tcp://scheduler:8786`, or the path of the scheduler's JSON file.
            transfer: as in `Remote`.
            silent_after: seconds without a sign of life after which a worker is given up, unless the scheduler has a
                `worker-ttl` of its own, which is then in place of them.

        Raises:
            ConfigError: distributed is not installed.
            ClusterError: no scheduler, no worker, or a worker without this version of meshfit.
        """
        self._client = _connected(address)
        workers = _workers(self._client, address)
        _check_versions(self._client)
        threads = max(int(worker["nthreads"]) for worker in workers.values())
        if threads > 1:
            text = f"workers have up to {threads} threads, but run one trial at a time; start them with --nthreads 1"
            warnings.warn(text, MeshfitWarning, stacklevel=2)
        gpus = sum(int(worker.get("resources", {}).get(_GPU, 0)) for worker in workers.values())
        super().__init__(_DaskExecutor(self._client), gpus=gpus, transfer=transfer)
        self.workers = len(workers)
        self._topics = list[str]()
        self._closed = threading.Event()
        threading.Thread(target=self._give_up_silent, args=(silent_after,), daemon=True).start()

    def channel(self, receive: Callable[[int, Files], None]) -> Channel:
        """Return a channel of events, which the scheduler passes on."""
        topic = f"meshfit-{uuid.uuid4().hex}"

        def handle(event: tuple[float, Mapping[str, Any]]) -> None:
            receive(int(event[1]["trial"]), event[1]["files"])

        self._client.subscribe_topic(topic, handle)
        self._topics.append(topic)
        return EventChannel(topic)

    def _give_up_silent(self, seconds: float) -> None:
        """Have workers that are silent replaced, until the connection is closed."""
        silent: list[str] = []
        while not self._closed.wait(min(_SECONDS_BETWEEN_LOOKS, seconds / 4)):
            # The scheduler may be away for a while, or for good, which the results of trials show.
            with suppress(Exception):
                silent = self._client.run_on_scheduler(_restarting(seconds, silent))

    def cancellation_flag(self, root: Path) -> CancellationFlag:  # noqa: ARG002  it is not a file
        """Return a new cancellation flag."""
        return CancellationEvent(f"meshfit-{uuid.uuid4().hex}", self._client)

    def on_workers(self, function: Callable[..., Any], *args: object) -> list[Any]:
        """Call a function on every worker, and return the results."""
        return list(self._client.run(function, *args).values())

    def close(self) -> None:
        """Disconnect from the cluster, which keeps running."""
        self._closed.set()
        for topic in self._topics:
            with suppress(OSError, RuntimeError, TimeoutError):
                self._client.unsubscribe_topic(topic)
        self._client.close()


class _DaskExecutor(Executor):
    """Dask's executor, with a GPU reserved for each job that requires one."""

    def __init__(self, client: Any) -> None:  # noqa: ANN401  distributed is optional
        self._plain = client.get_executor(pure=False)
        self._on_gpu = client.get_executor(pure=False, resources={_GPU: 1})

    def submit(
        self, fn: Callable[_Parameters, _Result], /, *args: _Parameters.args, **kwargs: _Parameters.kwargs
    ) -> Future[_Result]:
        """Have a worker call a function."""
        device = str(getattr(args[0], "device", "")) if args else ""
        chosen = self._on_gpu if device.startswith("cuda") else self._plain
        future: Future[_Result] = chosen.submit(fn, *args, **kwargs)
        return future


def _restarting(seconds: float, before: Sequence[str]) -> Callable[..., Any]:
    """Return a function for the scheduler, which restarts workers that are silent, and were so at the last look.

    It returns those that are silent. As a local function, it travels whole, to a scheduler without meshfit. A look
    alone does not tell silent workers from a scheduler that was stopped itself.
    """

    async def restart(dask_scheduler: Any) -> list[str]:  # noqa: ANN401  distributed is optional
        import time

        if dask_scheduler.worker_ttl != _DEFAULT_TTL:
            return []
        now = time.time()
        silent = [address for address, worker in dask_scheduler.workers.items() if now - worker.last_seen > seconds]
        if lost := [address for address in silent if address in before]:
            await dask_scheduler.restart_workers(lost, wait_for_workers=False, stimulus_id=f"meshfit-silent-{now}")
        return silent

    return restart


def _connected(address: str) -> Any:  # noqa: ANN401  distributed is optional
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise ConfigError("--cluster requires Dask, which is not installed: pip install 'meshfit[dask]'") from None
    # Errors arrive as exceptions; Dask's own logs would break the progress bars.
    for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    if ":" not in address and not Path(address).is_file():
        raise ClusterError(f"{address}: no such file; expected the file of a scheduler, or its address tcp://HOST:PORT")
    where = {"scheduler_file": address} if Path(address).is_file() else {"address": address}
    try:
        return distributed.Client(**where, timeout=_CONNECT_SECONDS, set_as_default=False, name="meshfit")
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).partition("\n")[0]
        raise ClusterError(
            f"{address}: no Dask scheduler can be reached there: {reason}; `dask scheduler` starts one"
        ) from None


def _workers(client: Any, address: str) -> Mapping[str, Any]:  # noqa: ANN401  distributed is optional
    try:
        client.wait_for_workers(1, timeout=_WORKER_SECONDS)
    except TimeoutError:
        raise ClusterError(
            f"{address}: no worker connected within {_WORKER_SECONDS} s; start some: dask worker {address} --nthreads 1"
        ) from None
    workers: Mapping[str, Any] = client.scheduler_info(n_workers=-1)["workers"]
    return workers


def _check_versions(client: Any) -> None:  # noqa: ANN401  distributed is optional
    for worker, answer in client.run(_results_version, on_error="return").items():
        if isinstance(answer, BaseException):
            raise ClusterError(f"worker {worker} cannot load meshfit ({answer}); install it there")
        if answer != RESULTS_VERSION:
            raise ClusterError(f"worker {worker} has another version of meshfit; install the same one everywhere")


def _results_version() -> int:
    return RESULTS_VERSION
