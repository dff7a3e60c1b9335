"""Later measurements of complete trials with other settings, without their fits."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import closing
from pathlib import Path
from typing import Any, Literal, NamedTuple

from meshfit.errors import MeshfitError, StoreError
from meshfit.experiment.running.process_pool import ONE_THREAD, ProcessPool, environment
from meshfit.experiment.running.shared_progress import SharedProgress
from meshfit.experiment.storage.frame import frame_of, written_frame
from meshfit.experiment.storage.measurement import AGAIN, with_measurement, write_measurement
from meshfit.experiment.storage.result import package_versions
from meshfit.experiment.storage.run_directory import Result, read_result
from meshfit.experiment.storage.targets import read_target, read_written_mesh, triangles
from meshfit.measuring.settings import MeasureSettings
from meshfit.settings import build, override

_INDEPENDENT = "quality"
"""The group of metrics that depends on the result alone; like those that compare with the source, the truth, landmarks
or masks, it does not depend on settings of the measurement, and stays as it is."""


class MeasuredAgain(NamedTuple):
    """Outcome of measuring a trial again; `error` is one line, empty unless it is `failed`."""

    folder: Path
    state: Literal["measured", "kept", "failed"]
    error: str = ""


def measure_trials_again(folders: Sequence[Path], changes: Mapping[str, Any], jobs: int) -> Iterator[MeasuredAgain]:
    """Measure complete trials again, and yield each outcome as soon as it is known.

    The values do not depend on the number of processes. A trial that already has the measurement is kept, so that the
    same call continues one that was stopped.

    Args:
        folders: folders of complete trials.
        changes: settings of the measurement in place of those of the fit.
        jobs: number of processes; 1 measures in this one.
    """
    if jobs == 1 or len(folders) == 1:
        yield from (measure_trial_again(folder, changes) for folder in folders)
        return
    with (
        environment(ONE_THREAD),
        closing(
            ProcessPool(min(jobs, len(folders)), SharedProgress.of(1), preload="meshfit.measuring.measure")
        ) as pool,
    ):
        for future in as_completed([pool.submit("cpu", measure_trial_again, path, changes) for path in folders]):
            yield future.result()


def measure_trial_again(folder: Path, changes: Mapping[str, Any]) -> MeasuredAgain:
    """Measure a complete trial again with other settings; see `measure_trials_again`."""
    try:
        return MeasuredAgain(folder, "measured" if _measure_again(folder, changes) else "kept")
    except MeshfitError as error:
        return MeasuredAgain(folder, "failed", "; ".join(error.faults))


def _measure_again(folder: Path, changes: Mapping[str, Any]) -> bool:
    """Measure and write, unless the same version has already measured with these settings."""
    result = read_result(folder)
    if result is None:
        raise StoreError(f"{folder}: the trial is not complete; `meshfit run` completes it")
    settings = override(build(MeasureSettings, result["settings"].get("measure", {})), changes)
    plain, versions = settings.model_dump(mode="json"), package_versions()
    if _has(folder, result, plain, versions):
        return False
    from meshfit.measuring.measure import measure

    try:
        frame = frame_of(result)
    except (KeyError, TypeError, ValueError):
        raise StoreError(f"{folder}: its result has no frame; `meshfit run --force` repeats the trial") from None
    mesh, target = triangles(read_written_mesh(folder / "result.ply")), read_target(folder, result)
    if written_frame(result) == "target":
        mesh = frame.normalise(mesh)
    measured = measure(mesh, frame.normalise(target), settings).to_dict()
    values = {group: value for group, value in measured.items() if group != _INDEPENDENT}
    write_measurement(folder, result, values, plain, versions)
    return True


def _has(folder: Path, result: Result, settings: Mapping[str, Any], versions: Mapping[str, str]) -> bool:
    try:
        latest = with_measurement(folder, result)
    except StoreError:  # damaged, and about to be overwritten
        return False
    return bool(latest.get(AGAIN, {}).get("versions") == versions and latest["settings"]["measure"] == settings)
