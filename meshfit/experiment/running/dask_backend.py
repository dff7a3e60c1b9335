"""Workers of an existing Dask cluster (the extra `dask`)."""

import importlib
import logging
import uuid
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from meshfit.errors import ClusterError, ConfigError, MeshfitWarning
from meshfit.experiment.results_version import RESULTS_VERSION
from meshfit.experiment.running.backends import Remote, Transfer
from meshfit.experiment.running.worker import CancellationFlag

_CONNECT_SECONDS = 8
_WORKER_SECONDS = 300
_GPU = "GPU"

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


class DaskRemote(Remote):
    """Workers of a Dask cluster; Dask passes a trial whose worker is lost to another one."""

    def __init__(self, address: str, *, transfer: Transfer = "auto") -> None:
        """Connect to a scheduler, and wait until it has a worker.

        Args:
            address: an address such as `tcp://scheduler:8786`, or the path of the scheduler's JSON file.
            transfer: as in `Remote`.

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

    def cancellation_flag(self, root: Path) -> CancellationFlag:  # noqa: ARG002  it is not a file
        """Return a new cancellation flag."""
        return CancellationEvent(f"meshfit-{uuid.uuid4().hex}", self._client)

    def on_workers(self, function: Callable[..., Any], *args: object) -> list[Any]:
        """Call a function on every worker, and return the results."""
        return list(self._client.run(function, *args).values())

    def close(self) -> None:
        """Disconnect from the cluster, which keeps running."""
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
