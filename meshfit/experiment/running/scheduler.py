"""Scheduler: run many trials side by side, on this machine or on remote workers; one that dies stops no other."""

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, as_completed, wait
from dataclasses import dataclass, field

from meshfit.errors import ClusterError, MeshfitError
from meshfit.experiment.plan import Trial
from meshfit.experiment.running.backends import (
    Backend,
    LocalBackend,
    LocalWorkers,
    Options,
    ProgressReader,
    Remote,
    RemoteBackend,
    is_death,
)
from meshfit.experiment.running.commands import require_installed, require_permission
from meshfit.experiment.running.process_pool import MOST_DEATHS, ONE_THREAD, environment, workers_die
from meshfit.experiment.running.unusable_targets import record_unusable, remove_outdated_failures
from meshfit.experiment.running.worker import JobResult, store_outputs
from meshfit.experiment.storage.failure import RETRIED, failed_attempts, killed_record
from meshfit.experiment.storage.folder_checks import check_folders
from meshfit.experiment.storage.plan_file import update_order, write_plan
from meshfit.experiment.storage.run_directory import FAILURE, LOG, RunDirectory, json_text, now
from meshfit.experiment.trial_status import Outcome, TrialStatus

_POLL_SECONDS = 0.1

Watcher = Callable[[ProgressReader, Mapping[int, Outcome]], None]


def run_trials(  # noqa: PLR0913  all but two have a default, and each can be set without the others
    trials: Sequence[Trial],
    store: RunDirectory,
    *,
    jobs: int | None = None,
    force: bool = False,
    remote: Remote | None = None,
    local: LocalWorkers | None = None,
    allow_commands: bool = False,
    watch: Watcher = lambda *_: None,
) -> dict[int, Outcome]:
    """Run trials and wait for them: single trials side by side on the CPU, batches on other devices.

    A trial whose process dies, or that runs out of memory, is retried as often as its `retries` allow; on this machine
    alone, after all others are done, so that it has the memory to itself. A trial whose target cannot be used fails
    without a process. Processes of this machine do not import the main module, so that a script that calls this needs
    no `if __name__ == "__main__"`.

    Args:
        trials: the trials; complete ones are skipped.
        store: the run directory.
        jobs: the number of processes on the CPU of this machine; None takes it from the settings.
        force: rerun complete trials.
        remote: remote workers, in place of processes of this machine.
        local: processes of this machine that outlast the run; None starts new ones, and ends them with the run.
        allow_commands: run the external commands of trials.
        watch: called many times a second with the progress of all trials and the outcomes so far.

    Returns:
        The outcome of each trial, by its index in `trials`.

    Raises:
        ConfigError: a trial has a command, and these are not allowed, or a tool that is not installed here.
        KeyboardInterrupt: after every running trial has written a checkpoint.
        StoreError: the run directory cannot be written to, or the folder of a trial is not in it.
        DeviceError: no worker has the device of a trial.
        ClusterError: remote workers cannot be reached.
        TrialError: workers die before they start a trial.
    """
    check_folders(trials, store)
    outcomes: dict[int, Outcome] = {}
    if not force:
        complete = (i for i, trial in enumerate(trials) if store.is_complete(trial))
        outcomes |= dict.fromkeys(complete, Outcome(TrialStatus.COMPLETE))
    remove_outdated_failures(trials, store)
    unusable = [i for i, trial in enumerate(trials) if trial.fault and i not in outcomes]
    outcomes |= {i: record_unusable(trials[i], store) for i in unusable}
    pending = [i for i in range(len(trials)) if i not in outcomes]
    if not pending:
        update_order(trials, store)
        return outcomes
    require_runnable([trials[i] for i in pending], allow_commands=allow_commands, here=remote is None)
    backend: Backend
    options = Options(force, allow_commands)
    with environment(ONE_THREAD):
        if remote is None:
            backend = LocalBackend(trials, pending, store, jobs, options, local)
        else:
            backend = RemoteBackend(remote, trials, store, outcomes, options)
        write_plan(trials, store, backend.workers)
        _Scheduler(trials, store, backend, outcomes, watch, force).run(pending)
    return outcomes


def require_runnable(trials: Sequence[Trial], *, allow_commands: bool, here: bool) -> None:
    """Refuse trials that cannot or may not be run.

    Args:
        trials: the trials to run.
        allow_commands: run the external commands of trials.
        here: whether this machine runs them.

    Raises:
        ConfigError: a trial has a command, and these are not allowed, or a tool that is not installed here.
    """
    require_permission(trials, allowed=allow_commands)
    if here:
        require_installed(trials)


@dataclass
class _Scheduler:
    """Sends batches to a backend, collects their outcomes and retries what can be retried."""

    trials: Sequence[Trial]
    store: RunDirectory
    backend: Backend
    outcomes: dict[int, Outcome]
    watch: Watcher
    force: bool
    sent: dict[Future[JobResult], tuple[int, ...]] = field(default_factory=dict)
    requeued: deque[int] = field(default_factory=deque)
    retries: Counter[int] = field(default_factory=Counter)
    deaths_at_start: int = 0

    def run(self, numbers: Sequence[int]) -> None:
        """Run trials until each has an outcome."""
        try:
            self._send(numbers)
            self._collect()
            while self.requeued:
                self._send([self.requeued.popleft()])
                self._collect()
        except BaseException:
            self.backend.cancel()
            self._store_cancelled()
            raise
        finally:
            self.backend.close()

    def _send(self, numbers: Sequence[int]) -> None:
        for device, batch in self.backend.batches({i: self.trials[i] for i in numbers}):
            future = self.backend.submit({i: self.trials[i] for i in batch}, device)
            self.sent[future] = batch

    def _store_cancelled(self) -> None:
        """Store the files that cancelled remote trials return."""
        for future in as_completed(self.sent) if not self.backend.is_local else ():
            if not _failed(future):
                self._store_files(future.result())

    def _collect(self) -> None:
        while self.sent:
            ended, _ = wait(self.sent, timeout=_POLL_SECONDS, return_when=FIRST_COMPLETED)
            # Results first: trials that ended before a worker died count.
            for future in sorted(ended, key=_failed):
                self._settle(future, self.sent.pop(future))
            self.backend.receive()
            self.watch(self.backend.progress, self.outcomes)

    def _settle(self, future: Future[JobResult], numbers: tuple[int, ...]) -> None:
        if _failed(future):
            self._settle_failed(future, numbers)
            return
        result = future.result()
        self._store_files(result)
        for i, outcome in result.outcomes.items():
            self.deaths_at_start = 0
            if outcome.kind not in RETRIED or not self._retry(i):
                self.outcomes[i] = outcome

    def _store_files(self, result: JobResult) -> None:
        for i, files in result.files.items():
            store_outputs(self.trials[i], files, self.store, force=self.force)

    def _settle_failed(self, future: Future[JobResult], numbers: tuple[int, ...]) -> None:
        """Settle a batch without outcomes.

        If a worker died with several trials, it is not known which one caused it, so each is sent by itself.
        """
        if future.cancelled():
            raise ClusterError("lost the connection to the workers; run the same command again to resume")
        error = future.exception()
        if error is None or not is_death(error):
            raise self._error_of_worker(error)
        if len(numbers) > 1:
            self.requeued.extend(numbers)
            return
        (i,) = numbers
        if self.backend.is_local and not self.backend.progress[i].status.is_running:
            self.deaths_at_start += 1
            if self.deaths_at_start > MOST_DEATHS:
                raise workers_die()
            self.requeued.append(i)
            return
        outcome = self._record_killed(i)
        if not self.backend.is_local or not self._retry(i):
            self.outcomes[i] = outcome

    def _error_of_worker(self, error: BaseException | None) -> BaseException:
        """Return the error to raise for one outside of any trial; one on this machine is a bug, and raised as it is."""
        if isinstance(error, MeshfitError) or (error is not None and self.backend.is_local):
            return error
        return ClusterError(f"a worker could not run its trials: {type(error).__name__}: {error}")

    def _record_killed(self, i: int) -> Outcome:
        trial, step = self.trials[i], self.backend.progress[i].step.done
        record = killed_record(trial, step, failed_attempts(trial, self.store) + 1)
        with self.store.lock(trial):
            self.store.write(trial, FAILURE, json_text(record))
            self.store.append(trial, LOG, f"{now()}  killed at step {step}\n")
        self.backend.progress.reset(i)
        return Outcome(TrialStatus.FAILED, f"{record['kind']}: {record['message']}", record["kind"])

    def _retry(self, i: int) -> bool:
        """Queue a trial once more if its settings allow it; return whether they do."""
        self.retries[i] += 1
        if self.retries[i] > self.trials[i].settings.retries:
            return False
        self.backend.progress.reset(i)
        self.requeued.append(i)
        return True


def _failed(future: Future[JobResult]) -> bool:
    return future.cancelled() or future.exception() is not None
