"""Fits from file to file: planned, run side by side, written and judged as soon as each is complete."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from meshfit.cli.console import err, out, print_error, warn_once
from meshfit.cli.fit_outputs import FORMAT_OF_MANY, save_result
from meshfit.cli.fit_plan import FitOptions, plan_fit
from meshfit.cli.options import RunOptions, suggest_option
from meshfit.errors import MeshError, MeshfitError
from meshfit.images.specs import is_image_target
from meshfit.paths import STDOUT_PATHS, STREAM, file_stem, is_pipe, path_text

if TYPE_CHECKING:
    from meshfit.cli.verdict import Verdict
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.storage.run_directory import RunDirectory

_INPUTS, _DIGITS = "inputs", 12
"""Folder of what came through pipes, and digits of the hash in the names of its files."""


@dataclass(frozen=True)
class FitJob:
    """A target, the trial that fits it, and the files to write."""

    target: str
    output: str
    table: str | None
    trial: "Trial"


@dataclass(frozen=True)
class FitJobs:
    """Plans fits, runs them in a run directory and writes their results as soon as they are complete."""

    options: FitOptions
    folder: Path
    run_options: RunOptions
    output_format: str | None
    kept: bool
    started: float

    def plan(
        self,
        targets: Sequence[str],
        outputs: Sequence[str],
        tables: Sequence[str | None],
        input_format: str | None,
        *,
        many: bool,
    ) -> list[FitJob]:
        """Plan one fit per target; of many, name those that cannot be fitted, and go on."""
        jobs = []
        for target, output, table in zip(targets, outputs, tables, strict=True):
            try:
                with suggest_option("--format"):
                    trial = plan_fit(self._file_of(target, input_format), self.options)
                    jobs.append(FitJob(target, output, table, trial))
            except MeshfitError as error:
                if not many:
                    raise
                print_error(str(error) if target in str(error) else f"{path_text(target)}: {error}")
        return jobs

    def _file_of(self, target: str, input_format: str | None) -> str:
        """The file of a target; the content of standard input and of pipes is saved in the folder."""
        from meshfit.experiment.storage.run_directory import make_folder
        from meshfit.mesh.io.mesh_file import write_file
        from meshfit.mesh.targets import NAMED_TARGETS, open_target

        if target in NAMED_TARGETS or is_image_target(target):
            return target
        if target != STREAM and not is_pipe(target) and input_format is None:
            return target
        file = open_target(target, file_format=input_format, points=True)
        stem = "standard-input" if target == STREAM else file_stem(target)
        # Pipes of equal names differ in content.
        path = self.folder / _INPUTS / sha256(file.content).hexdigest()[:_DIGITS] / f"{stem}{file.suffix}"
        make_folder(path.parent)
        write_file(path, file.content)
        return str(path)

    def run(self, jobs: Sequence[FitJob], *, many: bool) -> list[tuple["Verdict", dict[str, object]]]:
        """Run the fits; write and judge each as soon as it is complete."""
        from meshfit.cli.early_warnings import EarlyWarnings
        from meshfit.cli.experiments import run_trials_of
        from meshfit.cli.fit_progress import show_fit
        from meshfit.cli.progress import show_progress
        from meshfit.experiment.running.backends import ProgressReader
        from meshfit.experiment.storage.run_directory import RunDirectory
        from meshfit.experiment.trial_status import Outcome, TrialStatus

        store = RunDirectory(self.folder)
        trials = list({job.trial.folder: job.trial for job in jobs}.values())
        if not trials:
            return []
        verdicts: dict[int, tuple[Verdict, dict[str, object]]] = {}
        settled: set[int] = set()

        def settle(outcomes: Mapping[int, Outcome]) -> None:
            for i in [i for i in outcomes if i not in settled]:
                settled.add(i)
                same = [k for k, job in enumerate(jobs) if job.trial.folder == trials[i].folder]
                for k in same:
                    if outcomes[i].status is TrialStatus.COMPLETE:
                        try:
                            verdicts[k] = self._write(jobs[k], store, many=many)
                        except MeshfitError as error:
                            print_error(str(error))
                    else:
                        print_error(f"{path_text(jobs[k].target)}: {outcomes[i].message}")

        quiet = self.run_options.quiet
        progress = show_progress(trials, quiet=quiet) if many else show_fit(trials[0], quiet=quiet)
        with progress as watch:

            def watch_and_settle(reader: ProgressReader, outcomes: Mapping[int, Outcome]) -> None:
                watch(reader, outcomes)
                if many:
                    settle(outcomes)

            watching = EarlyWarnings(trials, store).watching(watch_and_settle)
            outcomes = run_trials_of(trials, store, self.run_options, watching)
        settle(outcomes)
        return [verdicts[k] for k in sorted(verdicts)]

    def _write(self, job: FitJob, store: "RunDirectory", *, many: bool) -> tuple["Verdict", dict[str, object]]:
        """Write the result of a complete trial, and print the verdict on it."""
        from meshfit.cli.verdict import verdict_of
        from meshfit.experiment.storage.attributes import with_attributes
        from meshfit.experiment.storage.frame import frame_of, written_frame
        from meshfit.experiment.storage.run_directory import CORRESPONDENCE
        from meshfit.experiment.storage.targets import read_written_mesh
        from meshfit.measuring.metrics import MEASURED, OF_IMAGES
        from meshfit.mesh.attributes import SUPPORTED
        from meshfit.mesh.io.files import mesh_output_suffix
        from meshfit.mesh.io.mesh_file import write_file

        folder, record = store.folder(job.trial), store.result(job.trial)
        if record is None:
            raise MeshError(f"{path_text(job.target)}: its trial in {folder} has no result")
        path = folder / "result.ply"
        mesh = with_attributes(read_written_mesh(path), path, record)
        if written_frame(record) == "normalised":
            mesh = frame_of(record).restore(mesh)
        chosen = FORMAT_OF_MANY if many and self.output_format is None else self.output_format
        if mesh_output_suffix(job.output, chosen) != ".ply":
            # The share is in the verdict, and other formats have no place for the marks.
            mesh = mesh.with_attributes(mesh.attributes.without(SUPPORTED))
        save_result(mesh, job.output, chosen)
        if job.table is not None:
            write_file(job.table, (folder / CORRESPONDENCE).read_bytes())
        stem = file_stem(job.target)
        for text in record["warnings"]:
            # The verdict says this itself.
            if not text.startswith("source and target differ in topology") and text not in record["shortfalls"]:
                warn_once(text if not many or stem in text.partition(": ")[0] else f"{path_text(job.target)}: {text}")
        name = "standard output" if job.output in STDOUT_PATHS else path_text(job.output)
        waited = None if many else time.monotonic() - self.started
        verdict = verdict_of(job.target, name, folder, record, waited)
        # Lines of stderr go above the bars that are shown there.
        above_bars = many and err.is_terminal and out.is_terminal
        console = err if job.output in STDOUT_PATHS or above_bars else out
        if not self.run_options.as_json:
            for line in [verdict.line] if many else verdict.lines:
                console.print(line, soft_wrap=True, markup=False)
            if self.kept and not many:
                console.print(f"trial: {folder}", soft_wrap=True, markup=False)
        groups = dict.fromkeys(metric.partition(".")[0] for metric in (*MEASURED, *OF_IMAGES))
        return verdict, {group: record[group] for group in groups if group in record}
