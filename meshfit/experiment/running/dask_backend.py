"""Workers of a Dask cluster that is there already, however it was started (the extra `dask`)."""

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
from meshfit.experiment.plan import SCHEMA_VERSION
from meshfit.experiment.running.backends import Remote, StopSign, Transfer

_CONNECT_SECONDS = 8
_WORKER_SECONDS = 300
_GPU = "GPU"

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class EventStopSign:
    """A stop sign that the cluster's scheduler holds.

    Attributes:
        name: what workers ask for.
        client: of the one who sends trials; it does not travel.
    """

    name: str
    client: Any = field(default=None, compare=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """What travels is the name."""
        return type(self), (self.name,)

    def set(self) -> None:
        """Ask workers to stop."""
        self._event().set()

    def is_set(self) -> bool:
        """Whether they are asked to."""
        return bool(self._event().is_set())

    def clear(self) -> None:
        """Take the sign away."""
        self._event().clear()

    def _event(self) -> Any:  # noqa: ANN401  distributed is optional
        return importlib.import_module("distributed").Event(self.name, client=self.client)


class DaskRemote(Remote):
    """Workers of a Dask cluster. Dask hands a trial whose worker is lost to another one."""

    def __init__(self, address: str, *, transfer: Transfer = "auto") -> None:
        """Connect to a scheduler, and wait until it has a worker.

        Args:
            address: such as `tcp://scheduler:8786`, or the path of the scheduler's JSON file.
            transfer: as `Remote` has it.

        Raises:
            ConfigError: distributed is not installed.
            ClusterError: no scheduler, no worker, or workers without this version of meshfit.
        """
        self._client = _connected(address)
        workers = _workers(self._client, address)
        _check_versions(self._client)
        threads = max(int(worker["nthreads"]) for worker in workers.values())
        if threads > 1:
            text = f"workers have up to {threads} threads, and run one trial at a time; start them with --nthreads 1"
            warnings.warn(text, MeshfitWarning, stacklevel=2)
        gpus = sum(int(worker.get("resources", {}).get(_GPU, 0)) for worker in workers.values())
        super().__init__(_DaskExecutor(self._client), gpus=gpus, transfer=transfer)
        self.workers = len(workers)

    def stop_sign(self, root: Path) -> StopSign:  # noqa: ARG002  it needs no place
        """A new stop sign."""
        return EventStopSign(f"meshfit-{uuid.uuid4().hex}", self._client)

    def on_workers(self, function: Callable[..., Any], *args: object) -> list[Any]:
        """What every worker returns for a call."""
        return list(self._client.run(function, *args).values())

    def close(self) -> None:
        """Leave the cluster, which goes on."""
        self._client.close()


class _DaskExecutor(Executor):
    """Dask's executor, with a GPU set aside for jobs that need one."""

    def __init__(self, client: Any) -> None:  # noqa: ANN401  distributed is optional
        self._plain = client.get_executor(pure=False)
        self._on_gpu = client.get_executor(pure=False, resources={_GPU: 1})

    def submit(
        self,
        fn: Callable[_Parameters, _Result],
        /,
        *args: _Parameters.args,
        **kwargs: _Parameters.kwargs,
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
        raise ConfigError("--cluster needs Dask, which is not installed: pip install 'meshfit[dask]'") from None
    # What goes wrong reaches us as an exception; its own logs would be written over the progress bars.
    for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    if ":" not in address and not Path(address).is_file():
        raise ClusterError(
            f"{address}: no such file; the file of a scheduler, or its address tcp://HOST:PORT, is needed"
        )
    where = {"scheduler_file": address} if Path(address).is_file() else {"address": address}
    try:
        return distributed.Client(**where, timeout=_CONNECT_SECONDS, set_as_default=False, name="meshfit")
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).partition("\n")[0]
        raise ClusterError(
            f"{address}: no Dask scheduler to be reached there: {reason}; `dask scheduler` starts one"
        ) from None


def _workers(client: Any, address: str) -> Mapping[str, Any]:  # noqa: ANN401  distributed is optional
    try:
        client.wait_for_workers(1, timeout=_WORKER_SECONDS)
    except TimeoutError:
        raise ClusterError(
            f"{address}: no worker came within {_WORKER_SECONDS} s; start some: dask worker {address} --nthreads 1"
        ) from None
    found: Mapping[str, Any] = client.scheduler_info(n_workers=-1)["workers"]
    return found


def _check_versions(client: Any) -> None:  # noqa: ANN401  distributed is optional
    for worker, found in client.run(_schema_version, on_error="return").items():
        if isinstance(found, BaseException):
            raise ClusterError(f"worker {worker} cannot load meshfit ({found}); install it there")
        if found != SCHEMA_VERSION:
            raise ClusterError(f"worker {worker} has another version of meshfit; install the same one everywhere")


def _schema_version() -> int:
    return SCHEMA_VERSION
