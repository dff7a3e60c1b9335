"""Measurement of files: a target, places and landmarks that are known, and results one by one."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from meshfit.cli.console import err, out, print_error, print_warning
from meshfit.cli.measurements import OF_MASKS_ALONE, Measured, Values
from meshfit.cli.options import suggest_option
from meshfit.errors import ConfigError, MeshfitError
from meshfit.measuring.metrics import OF_IMAGES
from meshfit.mesh.placing_options import Normalisation
from meshfit.paths import MESH_SUFFIXES, STREAM, format_suffix, is_pipe, path_text
from meshfit.units import count_text

if TYPE_CHECKING:
    from meshfit.images.target import ImageTarget
    from meshfit.measuring.settings import MeasureSettings
    from meshfit.measuring.vertex_error import Truth
    from meshfit.mesh.cleaning_options import CleaningOptions
    from meshfit.mesh.landmarks import Landmarks, PlacedLandmarks
    from meshfit.mesh.mesh import Mesh, Verts
    from meshfit.mesh.normalisation import Frame
    from meshfit.mesh.point_cloud import PointCloud

_SAVE = "`meshfit save TRIAL -o FILE` writes"


@dataclass(frozen=True)
class MeasuredTarget:
    """The target in the coordinates of its files, and the images that it is made from, if it is."""

    shape: "Mesh | PointCloud"
    images: "ImageTarget | None"

    @classmethod
    def read(cls, name: str, load: "Callable[[str], Mesh | PointCloud]", metrics: Sequence[str]) -> "MeasuredTarget":
        """Load a target; refuse metrics of masks where it has none."""
        from meshfit.images.specs import is_image_target
        from meshfit.measuring.surface import turned_target

        if name != STREAM and is_image_target(name):
            from meshfit.images.targets import load_image_target

            images = load_image_target(name)
            return cls(turned_target(lambda: images.reference), images)
        for metric in metrics:
            if metric in OF_IMAGES:
                raise ConfigError(f"{metric}: {path_text(name)} has no masks; give a folder of images as the target")
        return cls(turned_target(lambda: load(name)), None)

    @property
    def about(self) -> dict[str, str]:
        """The reference of the distances, as the record names it."""
        return {} if self.images is None else {"compared_with": self.images.compared_with}

    @property
    def metrics(self) -> list[str] | None:
        """The metrics that mean something, where not all do."""
        if self.images is None or self.images.compared_with != "hull":
            return None
        return [name for name in OF_MASKS_ALONE if self.images.held_out or "held_out" not in name]

    def print_note(self) -> None:
        """Say why there are no distances, where there are none."""
        if self.metrics:
            out.print("\nwithout depth or a true mesh, only masks can be compared", soft_wrap=True, markup=False)


def loader(cleaning: "CleaningOptions", input_format: str | None) -> "Callable[[str], Mesh | PointCloud]":
    """Return a function that loads a mesh or points by name; the format is used where the name has none."""
    from meshfit.mesh.targets import NAMED_TARGETS, load_target, open_target

    def load(name: str) -> "Mesh | PointCloud":
        if name in NAMED_TARGETS or (format_suffix(name) in MESH_SUFFIXES and not is_pipe(name)):
            return load_target(name, cleaning)
        with suggest_option("--format"):
            return load_target(name, cleaning, file=open_target(name, file_format=input_format, points=True))

    return load


@dataclass(frozen=True)
class KnownPlaces:
    """The places where vertices belong, in the frame of the target, and the name of their file."""

    name: str
    positions: "Verts"

    @classmethod
    def read(cls, name: str, frame: "Frame") -> "KnownPlaces":
        """Load the places of a file of points, in a frame."""
        from meshfit.mesh.io.point_clouds import load_points

        with suggest_option("--format"):
            return cls(name, (load_points(name) - frame.centre) / frame.scale)

    def of(self, result: "Mesh", name: str) -> "Truth":
        """Return where vertices of a result belong; its file may have other vertices than the mesh that it became.

        Raises:
            ConfigError: neither has as many.
        """
        from meshfit.measuring.vertex_error import Truth
        from meshfit.mesh.targets import NAMED_TARGETS, load_target_with_vertex_map

        count = len(self.positions)
        if count == result.num_verts:
            return Truth.of_first(self.positions)
        if name != STREAM and (name in NAMED_TARGETS or not is_pipe(name)):
            _, vertex_map = load_target_with_vertex_map(name, polygons=False, attributes=False)
            in_file, in_mesh = vertex_map.pairs()
            if count == vertex_map.num_file_verts and int(in_mesh.max()) < result.num_verts:
                return Truth(in_mesh, self.positions[in_file])
        places = f"--truth {path_text(self.name)}: {count_text(count, 'vertex')}"
        raise ConfigError(f"{places}, but {path_text(name)} has {result.num_verts:,}; give a place for each of them")


@dataclass(frozen=True)
class LandmarkPairs:
    """Landmarks with positions on the target, in the coordinates of its file, and the source that they are on."""

    landmarks: "Landmarks"
    goals: "Verts"
    source: str | None

    @classmethod
    def read(cls, name: str, source: str | None, target_name: str, target: "Mesh | PointCloud") -> "LandmarkPairs":
        """Load landmarks, and find those of the target.

        Raises:
            ConfigError: places on the source, without a source.
        """
        from meshfit.mesh.io.landmark_files import load_landmarks
        from meshfit.mesh.places import Numbering

        loaded = load_landmarks(name)
        if source is None and any(row.place.kind == "position" for row in loaded):
            raise ConfigError(f"--landmarks {path_text(name)}: has positions on the source; give --source FILE as well")
        numbering = Numbering.of(target) if target_name == STREAM else Numbering.of_file(target_name)
        return cls(loaded, loaded.goal_positions(target, numbering), source)

    def on(self, result: "Mesh", name: str) -> "PlacedLandmarks":
        """Return the landmarks on a result with the faces of the source, or by the numbers of its own file."""
        from meshfit.mesh.mesh import Mesh
        from meshfit.mesh.places import Numbering
        from meshfit.mesh.targets import load_target_with_vertex_map

        where = self.source or name
        if where == STREAM:
            return self.landmarks.placed(result, Numbering.of(result), self.goals)
        mesh, vertex_map = load_target_with_vertex_map(where, polygons=False, attributes=False)
        mesh = mesh if isinstance(mesh, Mesh) else mesh.triangulated()
        placed = self.landmarks.placed(mesh, Numbering.of_file(where, vertex_map), self.goals)
        if mesh.num_verts != result.num_verts:
            counts = f"{path_text(where)} has {count_text(mesh.num_verts, 'vertex')}"
            raise ConfigError(f"--landmarks: {counts}, but {path_text(name)} {result.num_verts:,}")
        return placed


@dataclass(frozen=True)
class FileMeasurement:
    """Measurement of results by name, against one target in the frame of both."""

    load: "Callable[[str], Mesh | PointCloud]"
    frame: "Frame"
    target: "Mesh | PointCloud"
    settings: "MeasureSettings"
    write: str | None
    target_name: str
    truth: KnownPlaces | None
    landmarks: "LandmarkPairs | None"
    source: "Mesh | None"
    images: "ImageTarget | None"

    def measure(self, name: str) -> Values:
        """Load and measure a result, and write its deviation if that is wanted.

        Raises:
            MeshfitError: it cannot be loaded, measured or written.
        """
        from meshfit.measuring.deviation import deviation, encode_deviation
        from meshfit.measuring.measure import measure as measure_mesh
        from meshfit.mesh.any_target import require_mesh
        from meshfit.mesh.io.mesh_file import write_file
        from meshfit.mesh.outer_surface import outer_surface
        from meshfit.mesh.point_cloud import PointCloud

        loaded = require_mesh(self.load(name), name)
        result = self.frame.normalise(loaded)
        self._warn_of_mismatch(name, loaded, result)
        truth = None if self.truth is None else self.truth.of(result, name)
        pairs = None if self.landmarks is None else self.landmarks.on(loaded, name)
        placed = None if pairs is None else pairs.in_frame(self.frame.centre, self.frame.scale)
        values = measure_mesh(
            result,
            self.target,
            self.settings,
            source=self.source,
            truth=truth,
            landmarks=placed,
            images=None if self.images is None else self.images.views,
            held_out=None if self.images is None else self.images.held_out,
        ).to_dict()
        if self.write is not None:
            target = self.target
            if self.settings.surface == "outer" and not isinstance(target, PointCloud):
                target = outer_surface(target)
            content = encode_deviation(result, deviation(result, target), format_suffix(self.write))
            write_file(self.write, content)
        return values

    def _warn_of_mismatch(self, name: str, loaded: "Mesh", result: "Mesh") -> None:
        """Warn where the boxes of result and target say that the two are not in one frame."""
        from meshfit.mesh.mismatch import describe_mismatch

        mismatch = describe_mismatch(result, self.target)
        if not mismatch:
            return
        target, names = self.frame.restore(self.target), f"{path_text(name)} and {path_text(self.target_name)}"
        boxes = " and ".join(map(_size_text, (loaded, target))), " and ".join(map(_centre_text, (loaded, target)))
        frames: tuple[Normalisation, ...] = ("tutorial", "box")
        own = next((how for how in frames if not _mismatch_in(how, loaded, target)), None)
        if own is not None:
            remedy = f"the result seems to be in the target's {own} frame; {_SAVE} it in that of the target's file"
        else:
            remedy = f"give both in one frame and unit: --normalise maps both alike, and {_SAVE} the result of a trial "
            remedy += "in the frame of its target's file"
        print_warning(f"{names} {mismatch}: sizes {boxes[0]}, centres {boxes[1]}; {remedy}")


def _mismatch_in(how: Normalisation, result: "Mesh", target: "Mesh | PointCloud") -> str:
    from meshfit.mesh.mismatch import describe_mismatch
    from meshfit.mesh.normalisation import frame_of

    return describe_mismatch(result, frame_of(target.verts, how).normalise(target))


def _size_text(mesh: "Mesh | PointCloud") -> str:
    from meshfit.mesh.geometry import bounding_box

    low, high = bounding_box(mesh.verts)
    return " × ".join(f"{length:.3g}" for length in high - low)


def _centre_text(mesh: "Mesh | PointCloud") -> str:
    from meshfit.mesh.geometry import bounding_box

    low, high = bounding_box(mesh.verts)
    return f"({', '.join(f'{(least + most) / 2:.3g}' for least, most in zip(low, high, strict=True))})"


def measure_each(measuring: FileMeasurement, results: Sequence[str]) -> Iterator[Measured]:
    """Measure several results; name those that cannot be measured, and go on."""
    from rich.progress import track

    hidden = not err.is_terminal or len(results) < 2
    for name in track(results, "measuring", console=err, transient=True, disable=hidden):
        try:
            yield Measured(name, measuring.measure(name))
        except MeshfitError as error:
            text = str(error) if name in str(error) else f"{path_text(name)}: {error}"
            print_error(text)
            yield Measured(name, {}, text)
