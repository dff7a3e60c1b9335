"""Run many trials, side by side here or on workers elsewhere; one that dies takes none of the others with it."""

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, as_completed, wait

from meshfit.errors import ClusterError, MeshfitError, TrialError
from meshfit.experiment.plan import Trial
from meshfit.experiment.running.backends import Crew, LocalCrew, ProgressBoard, Remote, RemoteCrew, is_death
from meshfit.experiment.running.environment import ONE_THREAD, environment
from meshfit.experiment.running.progress import FileBoard
from meshfit.experiment.running.worker import Done, put_back
from meshfit.experiment.storage.failure import RETRIED, death_of, failed_attempts
from meshfit.experiment.storage.plan_file import write_plan
from meshfit.experiment.storage.run_directory import FAILURE, LOG, RunDirectory, now, write_json
from meshfit.experiment.trial_status import Outcome, Phase

_POLL_SECONDS = 0.1
_MOST_IDLE_DEATHS = 3

Watcher = Callable[[ProgressBoard, Mapping[int, Outcome]], None]


def run_trials(
    trials: Sequence[Trial],
    store: RunDirectory,
    *,
    jobs: int | None = None,
    force: bool = False,
    remote: Remote | None = None,
    watch: Watcher = lambda *_: None,
) -> dict[int, Outcome]:
    """Run trials and wait for them: side by side on the CPU, in batches on other devices.

    A trial whose process dies, or that runs out of memory, is tried again as often as its `retries` say: on this
    machine when all others are done, so that it has the memory to itself.

    Args:
        trials: what to run; those that are complete are left as they are.
        store: where their files go.
        jobs: how many processes on the CPU of this machine; None leaves it to the trials' settings.
        force: run complete ones too.
        remote: workers to send trials to, in place of processes of this machine.
        watch: called many times a second with the board of progress and the outcomes so far.

    Returns:
        The outcome of each trial, by its place in `trials`.

    Raises:
        KeyboardInterrupt: after every running trial has written a checkpoint.
        StoreError: the run directory cannot be written to.
        DeviceError: no worker has the device that a trial needs.
        ClusterError: workers elsewhere are out of reach.
        TrialError: workers die without having started a trial.
    """
    outcomes: dict[int, Outcome] = {}
    if not force:
        complete = (i for i, trial in enumerate(trials) if store.is_complete(trial))
        outcomes |= dict.fromkeys(complete, Outcome(Phase.COMPLETE))
    left = [i for i in range(len(trials)) if i not in outcomes]
    if not left:
        return outcomes
    crew: Crew
    with environment(ONE_THREAD):
        if remote is None:
            crew = LocalCrew.of(trials, left, store, jobs, force=force)
        else:
            crew = RemoteCrew(remote, store, FileBoard(trials, store, outcomes), force=force)
        write_plan(trials, store, crew.workers)
        _Session(trials, store, crew, outcomes, watch, force=force).run(left)
    return outcomes


class _Session:
    """Trials that are being run, and how those ended that have."""

    def __init__(
        self,
        trials: Sequence[Trial],
        store: RunDirectory,
        crew: Crew,
        outcomes: dict[int, Outcome],
        watch: Watcher,
        *,
        force: bool,
    ) -> None:
        self._trials, self._store, self._crew, self._force = trials, store, crew, force
        self._outcomes, self._watch = outcomes, watch
        self._sent: dict[Future[Done], tuple[int, ...]] = {}
        self._again: deque[int] = deque()
        self._tries: Counter[int] = Counter()
        self._idle_deaths = 0

    def run(self, numbers: Sequence[int]) -> None:
        """Run trials until each has an outcome."""
        try:
            for device, batch in self._crew.batches({i: self._trials[i] for i in numbers}):
                self._send(batch, device)
            self._collect()
            while self._again:
                again = self._again.popleft()
                for device, batch in self._crew.batches({again: self._trials[again]}):
                    self._send(batch, device)
                self._collect()
        except BaseException:
            self._crew.stop()
            self._drain()
            raise
        finally:
            self._crew.close()

    def _drain(self) -> None:
        """Take in what stopped trials give back."""
        for future in as_completed(self._sent) if not self._crew.on_this_machine else ():
            if not _failed(future):
                self._take_in(future.result())

    def _send(self, numbers: Sequence[int], device: str) -> None:
        future = self._crew.submit({i: self._trials[i] for i in numbers}, device)
        self._sent[future] = tuple(numbers)

    def _collect(self) -> None:
        while self._sent:
            ended, _ = wait(self._sent, timeout=_POLL_SECONDS, return_when=FIRST_COMPLETED)
            # Results first: what was finished beside a worker that died counts.
            for future in sorted(ended, key=_failed):
                self._settle(future, self._sent.pop(future))
            self._watch(self._crew.board, self._outcomes)

    def _settle(self, future: Future[Done], numbers: tuple[int, ...]) -> None:
        if _failed(future):
            self._lost(numbers, future)
            return
        done = future.result()
        self._take_in(done)
        for i, outcome in done.outcomes.items():
            self._idle_deaths = 0
            if outcome.kind not in RETRIED or not self._try_again(i):
                self._outcomes[i] = outcome

    def _take_in(self, done: Done) -> None:
        for i, files in done.files.items():
            put_back(self._trials[i], files, self._store, force=self._force)

    def _lost(self, numbers: tuple[int, ...], future: Future[Done]) -> None:
        """A batch without outcomes: of several trials it is not known which was to blame, so each is sent by itself."""
        if future.cancelled():
            raise ClusterError("lost touch with the workers; the same command goes on from here")
        error = future.exception()
        if error is None or not is_death(error):
            raise self._explained(error)
        if len(numbers) > 1:
            self._again.extend(numbers)
            return
        (i,) = numbers
        if self._crew.on_this_machine and self._crew.board.phase(i) not in (Phase.FITTING, Phase.MEASURING):
            self._idle_deaths += 1
            if self._idle_deaths > _MOST_IDLE_DEATHS:
                raise TrialError("worker processes die before they start a trial; perhaps there is not enough memory")
            self._again.append(i)
            return
        outcome = self._record_death(i)
        if not self._crew.on_this_machine or not self._try_again(i):
            self._outcomes[i] = outcome

    def _explained(self, error: BaseException | None) -> BaseException:
        """What was raised outside of any trial: here a fault of meshfit's own, elsewhere one of the workers'."""
        if isinstance(error, MeshfitError) or (error is not None and self._crew.on_this_machine):
            return error
        return ClusterError(f"a worker could not run its trials: {type(error).__name__}: {error}")

    def _record_death(self, i: int) -> Outcome:
        trial, step = self._trials[i], self._crew.board.step(i).done
        record = death_of(trial, step, failed_attempts(trial, self._store) + 1)
        with self._store.lock(trial):
            self._store.write(trial, FAILURE, write_json(record))
            self._store.append(trial, LOG, f"{now()}  killed at step {step}\n")
        self._crew.board.reset(i)
        return Outcome(Phase.FAILED, f"{record['kind']}: {record['message']}", record["kind"])

    def _try_again(self, i: int) -> bool:
        """Whether a trial is to be tried once more; if so, it will be."""
        self._tries[i] += 1
        if self._tries[i] > self._trials[i].settings.retries:
            return False
        self._crew.board.reset(i)
        self._again.append(i)
        return True


def _failed(future: Future[Done]) -> bool:
    return future.cancelled() or future.exception() is not None
