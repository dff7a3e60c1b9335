"""`search-….json`: the points of a search in the order in which they were asked, in the folder of the experiment."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from meshfit.errors import StoreError
from meshfit.experiment.storage.run_directory import json_text, make_folder, read_json, write_atomically
from meshfit.experiment.tuning.objectives import Objective, front

SEARCH_FILE_VERSION = 1
ASKED, COMPLETE, FAILED = "asked", "complete", "failed"
OWN = "config's own"
"""Name of the point with the config's own settings."""


@dataclass(frozen=True)
class Point:
    """Settings that a search tries.

    Attributes:
        changes: value of each searched setting, by dotted key.
        name: of the point, as in tables.
        state: `asked`, `complete` or `failed`.
        values: of each objective, of a complete point.
        reason: why it failed.
        batch: number of the batch in which it was asked.
    """

    changes: Mapping[str, Any]
    name: str
    state: str = ASKED
    values: tuple[float, ...] = ()
    reason: str = ""
    batch: int = 0


@dataclass(frozen=True)
class Search:
    """A search.

    Attributes:
        experiment: name of the experiment.
        key: digits that distinguish it from other searches of the experiment.
        objectives: the objectives.
        ranges: range of each searched setting, by dotted key, as a config holds them.
        cells: targets, schemes and seeds of each point.
        own: the config's own settings, which are measured for comparison.
        points: the points, in the order in which they were asked.
    """

    experiment: str
    key: str
    objectives: tuple[Objective, ...]
    ranges: Mapping[str, Any]
    cells: Mapping[str, Sequence[Any]]
    own: Point
    points: tuple[Point, ...] = field(default=())

    @property
    def complete(self) -> list[int]:
        """Indices of the complete points."""
        return [i for i, point in enumerate(self.points) if point.state == COMPLETE]

    @property
    def failed(self) -> list[int]:
        """Indices of the failed points."""
        return [i for i, point in enumerate(self.points) if point.state == FAILED]

    @property
    def best(self) -> list[int]:
        """Indices of the best points: one of a single objective, else the Pareto front by its first objective."""
        complete = self.complete
        values = [self.points[i].values for i in complete]
        first = {values[i]: complete[i] for i in reversed(front(values, self.objectives))}
        return sorted(first.values(), key=lambda i: -self._gain(i))

    @property
    def ranked(self) -> list[int]:
        """Indices of the complete points, the best in the first objective first."""
        return sorted(self.complete, key=lambda i: -self._gain(i))

    def _gain(self, index: int) -> float:
        return self.objectives[0].gain(self.points[index].values[0], 0.0)

    def with_points(self, points: Sequence[Point]) -> "Search":
        """Return the search with other points."""
        return replace(self, points=tuple(points))


def search_path(root: Path, experiment: str, key: str) -> Path:
    """Return the path of a search's file."""
    return root / experiment / f"search-{key}.json"


def write_search(root: Path, search: Search) -> None:
    """Write the file of a search atomically.

    Raises:
        StoreError: it cannot be written.
    """
    path = search_path(root, search.experiment, search.key)
    make_folder(path.parent)
    write_atomically(path, json_text({"schema_version": SEARCH_FILE_VERSION, **asdict(search)}))


def read_search(path: Path) -> Search:
    """Read the file of a search.

    Raises:
        StoreError: it cannot be read, or is of another version.
    """
    content = read_json(path)
    if (got := content.get("schema_version")) != SEARCH_FILE_VERSION:
        raise StoreError(f"{path}: got schema_version {got}, expected {SEARCH_FILE_VERSION}; delete it to search again")
    try:
        return Search(
            experiment=str(content["experiment"]),
            key=str(content["key"]),
            objectives=tuple(Objective(str(each["metric"]), bool(each["maximise"])) for each in content["objectives"]),
            ranges=dict(content["ranges"]),
            cells=dict(content["cells"]),
            own=_point(content["own"]),
            points=tuple(map(_point, content["points"])),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise StoreError(f"{path}: not a search: {reason}; delete it to search again") from None


def read_searches(folders: Sequence[Path]) -> dict[Path, list[Search]]:
    """Read the searches in the folders of some experiments, the latest last; folders without any are left out.

    Raises:
        StoreError: a file cannot be read.
    """
    searches = {}
    for folder in dict.fromkeys(folders):
        paths = sorted(folder.glob("search-*.json"), key=lambda path: (path.stat().st_mtime, path.name))
        if found := [search for path in paths if (search := read_search(path)).complete or search.failed]:
            searches[folder] = found
    return searches


def _point(content: Mapping[str, Any]) -> Point:
    values = tuple(map(float, content["values"]))
    if content["state"] not in (ASKED, COMPLETE, FAILED):
        raise ValueError(f"state is {json.dumps(content['state'])}")
    return Point(
        dict(content["changes"]),
        str(content["name"]),
        content["state"],
        values,
        str(content["reason"]),
        int(content["batch"]),
    )
