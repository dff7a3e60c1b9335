"""Later measurements of complete trials with other settings, without their fits."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import closing
from pathlib import Path
from typing import Any, Literal, NamedTuple

from meshfit.config.experiment import ExperimentSettings
from meshfit.errors import ConfigError, MeshfitError, StoreError
from meshfit.experiment.running.process_pool import ONE_THREAD, ProcessPool, environment
from meshfit.experiment.running.shared_progress import SharedProgress
from meshfit.experiment.storage.frame import frame_of, written_frame
from meshfit.experiment.storage.measurement import (
    AGAIN,
    remove_measurement,
    with_measurement,
    write_measurement,
)
from meshfit.experiment.storage.mesh_files import check_mesh_file
from meshfit.experiment.storage.result import package_versions
from meshfit.experiment.storage.run_directory import Result, read_result
from meshfit.experiment.storage.targets import read_target, read_written_mesh, triangles
from meshfit.measuring.distance import Distance
from meshfit.measuring.mask_overlap import MaskOverlap
from meshfit.measuring.settings import MeasureSettings
from meshfit.measuring.verdict import OF_FIT
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.settings import build, override

_INDEPENDENT = "quality"
"""The group of metrics that depends on the result alone; like those that compare with the source, the truth, landmarks
or masks, it does not depend on settings of the measurement, and stays as it is."""


State = Literal["measured", "kept", "restored", "failed"]
"""Whether a trial was measured, or had these values before, or has those of its fit again, or cannot be measured."""


class MeasuredAgain(NamedTuple):
    """Outcome of measuring a trial again; `error` is one line, empty unless it is `failed`."""

    folder: Path
    state: State
    error: str = ""


def measure_trials_again(folders: Sequence[Path], changes: Mapping[str, Any], jobs: int) -> Iterator[MeasuredAgain]:
    """Measure complete trials again, and yield each outcome as soon as it is known.

    The values do not depend on the number of processes. A trial that already has the measurement is kept, so that the
    same call continues one that was stopped. With the settings and the version of the fit, a trial has the values of
    the fit again.

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
        return MeasuredAgain(folder, _measure_again(folder, changes))
    except MeshfitError as error:
        return MeasuredAgain(folder, "failed", "; ".join(error.faults))


def _measure_again(folder: Path, changes: Mapping[str, Any]) -> State:
    """Measure and write, unless the same version has already measured with these settings."""
    result = read_result(folder)
    if result is None:
        raise StoreError(f"{folder}: the trial is not complete; `meshfit run` completes it")
    before = build(MeasureSettings, result["settings"].get("measure", {}))
    settings = override(before, changes)
    if settings == before and package_versions().items() <= result.get("versions", {}).items():
        return "restored" if remove_measurement(folder) else "kept"
    plain, versions = settings.model_dump(mode="json"), package_versions()
    if _has(folder, result, plain, versions):
        return "kept"
    write_measurement(folder, result, _measured(folder, result, settings), plain, versions)
    return "measured"


def _measured(folder: Path, result: Result, settings: MeasureSettings) -> dict[str, Any]:
    """Return the entries of a result that depend on the settings of the measurement."""
    from meshfit.measuring.measure import measure

    try:
        frame = frame_of(result)
    except (KeyError, TypeError, ValueError):
        raise StoreError(f"{folder}: its result has no frame; `meshfit run --force` repeats the trial") from None

    def placed(name: str) -> Mesh:
        check_mesh_file(folder / name, result)
        mesh = triangles(read_written_mesh(folder / name))
        return frame.normalise(mesh) if written_frame(result) == "target" else mesh

    mesh, target = placed("result.ply"), frame.normalise(read_target(folder, result))
    measured = measure(mesh, target, settings)
    values = {group: value for group, value in measured.to_dict().items() if group != _INDEPENDENT}
    if "verdict" not in result:  # of an older version
        return values
    return values | _judged((mesh, placed("source.ply"), target), folder, result, measured.distance, settings)


def _judged(
    meshes: tuple[Mesh, Mesh, Mesh | PointCloud],
    folder: Path,
    result: Result,
    distance: Distance,
    settings: MeasureSettings,
) -> dict[str, Any]:
    """Return the verdict, the shortfalls and the warnings of a result; what the fit itself has found stays."""
    from meshfit.experiment.running.trial_verdict import judge

    try:
        masks = MaskOverlap(**result["iou"]) if "iou" in result else None
        of_masks = [] if masks is None else masks.shortfalls
        found = [str(check["text"]) for check in result["verdict"]["checks"] if check["name"] == OF_FIT]
        before = list(map(str, result["shortfalls"]))
        of_trial = build(ExperimentSettings, result["settings"]).model_copy(update={"measure": settings})
        compared_with = str(result.get("images", {}).get("compared_with", ""))
    except (ConfigError, KeyError, TypeError, AttributeError):
        raise StoreError(
            f"{folder}: its settings or its verdict are not those of this version; `meshfit run --force` repeats it"
        ) from None
    of_fit = [text for text in found if text and text not in of_masks]
    short, verdict = judge(meshes, of_trial, distance, masks, of_fit=of_fit, compared_with=compared_with)
    others = [text for text in result.get("warnings", ()) if text not in before]
    return {"verdict": verdict.to_dict(), "shortfalls": short, "warnings": list(dict.fromkeys([*others, *short]))}


def _has(folder: Path, result: Result, settings: Mapping[str, Any], versions: Mapping[str, str]) -> bool:
    try:
        latest = with_measurement(folder, result)
    except StoreError:  # damaged, and about to be overwritten
        return False
    return bool(latest.get(AGAIN, {}).get("versions") == versions and latest["settings"]["measure"] == settings)
