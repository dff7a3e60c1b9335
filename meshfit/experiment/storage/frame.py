"""The frame of a trial, as its records state it: the map to normalised coordinates, and the frame of its meshes."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Literal

from meshfit.experiment.storage.run_directory import Result

if TYPE_CHECKING:
    from meshfit.mesh.normalisation import Frame

WriteFrame = Literal["target", "normalised"]
"""Frame of the meshes that a trial writes: the target file's own, or the normalised one, that of its numbers."""


def frame_record(frame: "Frame", normalise: str, written: WriteFrame) -> Result:
    """Return the record of a trial's frame: centre and scale of the map, the setting `normalise`, and `written`."""
    return asdict(frame) | {"normalise": normalise, "written": written}


def frame_of(record: Result) -> "Frame":
    """Return the normalised frame of a trial.

    Args:
        record: content of its `result.json`, or of a `failure.json` that has a frame.

    Raises:
        KeyError, TypeError, ValueError: the record has none.
    """
    from meshfit.mesh.normalisation import Frame

    frame = record["frame"]
    x, y, z = map(float, frame["centre"])
    return Frame((x, y, z), float(frame["scale"]))


def written_frame(record: Result) -> WriteFrame:
    """Return the frame of the meshes in a trial's folder, from its record; older records have it in their settings."""
    settings = record.get("settings", {})
    written = record["frame"].get("written", settings.get("write_frame", "normalised"))
    return "target" if written == "target" else "normalised"
