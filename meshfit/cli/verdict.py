"""The verdict on a fit: how far it is from the target, whether it is sound, and what to try where it is not."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from meshfit.units import count_text, duration_text

if TYPE_CHECKING:
    from pathlib import Path

    from meshfit.experiment.storage.run_directory import Result

_FAR_PERCENT = 1.0
# Shares of the surface from here on are all of it.
_ALL_BUT_NOTHING = 0.999


@dataclass(frozen=True)
class Verdict:
    """Distances are in the unit of the target's file; percentages are of its diagonal.

    Attributes:
        max_distance: the largest distance, of both directions; from a cloud of points, that of its points alone.
        mean_distance: the mean distance, of both directions; from a cloud of points, that of its points alone.
        crossing_faces: faces that cross others.
        source_topology: pieces and genus, which the result has too.
        target_topology: those of the target; empty for a cloud of points, of which they are not known.
        target_points: number of points of a cloud; 0 for a mesh.
        seconds: that the user waited: of the whole command, or of one of its many fits, from loading to measuring.
        fit_seconds: those of the fit itself.
        output: the file that was written.
        made_from: what the source was made from: `target`, `wrap`, `sphere`, `solid` or `file`.
        reason: why.
        shortfalls: what the result lacks of the target, in words.
        surface: the part of the target that distances are from, `all` or `outer`.
        supported: share of the surface that the target shows; None if it has no holes.
        filled: number of openings of the target that the source fills, as set.
        registered: how the source was registered and why, where it was chosen; empty elsewhere.
        unmatched: share of a registered source without a partner on the target; None if none was registered.
        new_crossing_faces: faces that cross and did not in a registered source; None if none was registered.
        errors: how far vertices and landmarks are from where they belong, in words, as far as that is known.
        masks: how masks of the result and of images overlap, in words; empty for other targets.
        compared_with: what distances from images are to: `truth`, `depth` or `hull`; empty for other targets.
    """

    target: str
    output: str
    max_distance: float
    max_percent: float
    mean_distance: float
    mean_percent: float
    crossing_faces: int
    flipped_faces: int
    closed: bool
    result_topology: str
    source_topology: str
    target_topology: str
    target_points: int
    verts: int
    faces: int
    seconds: float
    fit_seconds: float
    made_from: str
    reason: str
    shortfalls: tuple[str, ...]
    surface: str
    supported: float | None
    filled: int = 0
    registered: str = ""
    unmatched: float | None = None
    new_crossing_faces: int | None = None
    errors: tuple[str, ...] = ()
    masks: str = ""
    compared_with: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the values and the advice as plain data."""
        return asdict(self) | {"advice": list(self.advice)}

    @property
    def lines(self) -> list[str]:
        """Three lines: distances; soundness; size, time and file. Advice follows where there is some.

        Errors of vertices and landmarks follow the distances where places are known.
        """
        distances = (
            f"distance{self._from}: worst {self.max_distance:.4g} ({self.max_percent:.2g} % of the diagonal), "
            f"mean {self.mean_distance:.4g} ({self.mean_percent:.2g} %), in the unit of the file"
        )
        new = "" if self.new_crossing_faces is None else f" ({self.new_crossing_faces:,} new)"
        sound = f"faces: {self.crossing_faces:,} crossing{new}, {self.flipped_faces:,} flipped; {self.result_topology}"
        if not self.target_topology:
            sound += " (target: points, without pieces or genus)"
        elif self.target_topology != self.result_topology:
            sound += f" (target: {self.target_topology})"
        return [
            *([self.masks] if self.masks else []),
            *([] if self.compared_with == "hull" else [distances]),
            *self.errors,
            sound,
            f"{self._size}: wrote {self.output}",
            *(f"note: {text}" for text in self.advice),
        ]

    @property
    def line(self) -> str:
        """One line, for one of many fits."""
        worst = f"{self._from} worst {self.max_distance:.4g} ({self.max_percent:.2g} %)"
        parts = [self.masks] if self.masks else []
        parts += [] if self.compared_with == "hull" else [worst.strip(), f"mean {self.mean_distance:.4g}"]
        parts.append(f"{self.crossing_faces:,} crossing, {self.flipped_faces:,} flipped")
        parts += [] if self.closed else ["open"]
        parts.append(self._size)
        parts += self.errors
        notes = "".join(f"; note: {text}" for text in self.advice)
        return f"{self.output}: {', '.join(parts)}{notes}"

    @property
    def advice(self) -> Iterator[str]:
        """Advice on each shortfall: the finding, and what to try."""
        if self.made_from == "wrap" and self.reason != "as set" and not self.target_points:
            yield f"started from a wrap around the target: {self.reason}; --source target starts from the target itself"
        if self.registered:
            yield self.registered
        if self.unmatched is not None:
            if self.unmatched > 1 - _ALL_BUT_NOTHING:
                share = f"{100 * self.unmatched:.2g} % of the source"
                yield f"{share} has no partner on the target, and keeps its shape there"
        elif self.supported is not None and self.supported < _ALL_BUT_NOTHING:
            share = f"{100 * (1 - self.supported):.2g} % of the surface"
            if self.filled:
                yield f"filled as set: {count_text(self.filled, 'opening')} of the target, {share}"
            else:
                yield f"{share} is filled in: the target shows nothing there"
        own = self.made_from == "target" or self.unmatched is not None  # a template is not to be replaced
        for text in self.shortfalls:
            from_target = "" if own else "; try --source target, which starts from all of them"
            yield text + (from_target if text.startswith("topology") else "")
        # A point may well lie off the surface, by noise, and what fills a hole is far from the target.
        if self.max_percent > _FAR_PERCENT and not (self.target_points or self.filled or self.compared_with):
            remedy = "--verts" if self.unmatched is None else "--levels"
            also = "" if own else " or --source target"
            yield f"worst distance above {_FAR_PERCENT:g} % of the diagonal; try more {remedy}{also}"

    @property
    def _from(self) -> str:
        """Words for the only direction that counts, of a cloud, or for the outer surface."""
        if self.surface == "outer":
            return " from the outer surface"
        if self.compared_with == "truth":
            return " from the true mesh"
        return f" from {count_text(self.target_points, 'point')}" if self.target_points else ""

    @property
    def _size(self) -> str:
        counts = f"{count_text(self.verts, 'vertex')}, {count_text(self.faces, 'face')}"
        return f"{counts}, {duration_text(self.seconds)} (fit {duration_text(self.fit_seconds)})"


def verdict_of(target: str, output: str, folder: "Path", record: "Result", waited: float | None = None) -> Verdict:
    """Return the verdict on a complete trial, from its record and the meshes in its folder.

    Args:
        target: the target as the user named it.
        output: the file that was written.
        folder: of the trial.
        record: of the trial.
        waited: seconds that the whole command took; None for those of the trial.

    Raises:
        MeshError: a mesh cannot be read.
    """
    from meshfit.experiment.storage.frame import frame_of
    from meshfit.experiment.storage.targets import read_target, read_written_mesh, triangles
    from meshfit.mesh.manifold import TopologyCounts, describe_topology
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.topology import Topology

    scale = frame_of(record).scale
    target_mesh = read_target(folder, record)
    meshes = [triangles(read_written_mesh(folder / name)) for name in ("result.ply", "source.ply")]
    images = record.get("images", {})
    if images.get("compared_with") == "hull":  # a guess, whose pieces and handles are none to match
        target_mesh = meshes[0]
    meshes += [target_mesh] if isinstance(target_mesh, Mesh) else []
    topologies = [*(describe_topology(Topology.of(mesh)) for mesh in meshes), ""]
    is_filled = record["settings"].get("source", {}).get("mesh") == "closed" and isinstance(target_mesh, Mesh)
    openings = (
        [TopologyCounts.of(Topology.of(mesh)).openings for mesh in (meshes[-1], meshes[0])] if is_filled else [0, 0]
    )
    way = "symmetric", "mean"
    if "cloud" in record:  # its points stand for all of the surface that it shows, exactly
        way = "backward", "backward_mean"
    worst, mean = record["hausdorff"][way[0]], record["distance"][way[1]]
    share = record["hausdorff"]["percent_of_diagonal"] / (record["hausdorff"]["symmetric"] or 1.0)
    percent = worst * share
    quality, registered = record["quality"], record.get("register", {}).get("register", "off") != "off"
    return Verdict(
        target,
        output,
        max_distance=worst * scale,
        max_percent=percent,
        mean_distance=mean * scale,
        mean_percent=mean * share,
        crossing_faces=quality["self_intersecting_faces"],
        flipped_faces=quality["flipped_faces"],
        closed=quality["watertight"],
        result_topology=topologies[0],
        source_topology=topologies[1],
        target_topology=topologies[2],
        target_points=0 if isinstance(target_mesh, Mesh) else target_mesh.num_verts,
        verts=quality["verts"],
        faces=quality["faces"],
        seconds=sum(record["seconds"].values()) if waited is None else waited,
        fit_seconds=record["seconds"]["fit"],
        made_from=record["source"].get("made_from", ""),
        reason=record["source"].get("reason", ""),
        shortfalls=tuple(record.get("shortfalls", ())),
        surface=_surface(record["settings"]),
        supported=record.get("supported"),
        filled=max(openings[0] - openings[1], 0),
        registered=_registered(record),
        unmatched=record["unmatched"]["source"] if registered and "unmatched" in record else None,
        new_crossing_faces=record["new_defects"]["crossing_faces"] if registered and "new_defects" in record else None,
        errors=tuple(_errors(record, scale, share / scale)),
        masks=_masks(record["iou"]) if "iou" in record else "",
        compared_with=images.get("compared_with", ""),
    )


def _masks(iou: "Result") -> str:
    least = f", least {iou['least']:.4f} in '{iou['worst_view']}'" if iou["views"] > 1 else ""
    held_out = ""
    if iou["held_out_mean"] is not None:
        held_out = f"; {iou['held_out_mean']:.4f} in {iou['held_out']:,} held out"
    return f"masks: IoU {iou['mean']:.4f} in {count_text(iou['views'], 'view')}{least}{held_out}"


def _surface(settings: "Result") -> str:
    surfaces = (settings.get(key, {}).get("surface", "all") for key in ("target", "measure"))
    return "outer" if "outer" in surfaces else "all"


def _errors(record: "Result", scale: float, percent: float) -> Iterator[str]:
    """Yield how far vertices and landmarks are from where they belong.

    Args:
        record: of the trial.
        scale: unit of the record's lengths, in that of the file.
        percent: 1 in the unit of the file, in percent of the diagonal.
    """

    def text(rms: float, largest: float) -> str:
        lengths = f"rms {rms * scale:.4g} ({rms * scale * percent:.2g} % of the diagonal)"
        return f"{lengths}, worst {largest * scale:.4g}"

    if error := record.get("vertex_error"):
        yield f"vertex error: {text(error['rms'], error['max'])}"
    if error := record.get("landmark_error"):
        parts = [
            text(error[f"{prefix}rms"], error[f"{prefix}max"]) + suffix
            for prefix, suffix in (("", ""), ("left_out_", " of those held out"))
            if error[f"{prefix}rms"] is not None
        ]
        yield f"landmark error: {'; '.join(parts)}"


def _registered(record: "Result") -> str:
    from meshfit.fitting.registration.plan import Registered

    registered = Registered(**record["register"]) if "register" in record else None
    return registered.line if registered is not None and not registered.is_set else ""
