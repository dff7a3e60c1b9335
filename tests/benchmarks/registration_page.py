"""The page of the registration benchmark, from the results in its run directory."""

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from scipy.stats import binomtest

from tests.benchmarks.registration_pairs import Pair, slug

SOLVED = 0.02
"""Largest vertex error, as a share of the diagonal, of a registration that counts as solved."""
_METHODS = {
    "auto": "Gauss–Newton, `auto`",
    "off": "Gauss–Newton, `off`",
    "first-order": "first-order",
    "pycpd": "pycpd",
    "nricp-amberg": "nricp, Amberg",
    "nricp-sumner": "nricp, Sumner",
    "meshmonk": "MeshMonk",
    "nricp-amberg, landmarks": "nricp, Amberg, landmarks",
    "nricp-sumner, landmarks": "nricp, Sumner, landmarks",
}
_OURS = ("auto", "off", "first-order")

_INTRO = """# Registration of known pairs

Made by `make registration-bench`. The places of a template's vertices on the target are known, as the target is the
same shape, meshed otherwise and moved. `meshfit table` shows the same runs.

- **Templates** have about 1,500 vertices and targets 3,000, so that all tools can finish. All methods start from the
  same pose, and nothing else is given, unless a method says landmarks: 12, exact and far apart.
- **Pairs that were looked at** while settings of `register` were chosen come first; the others were never looked at.
  Options of the other tools were chosen on *walk* and *cow bent by 90°*, in few trials.
- **Vertex error** is the root mean square distance of vertices from where they belong. All distances are in percent of
  the diagonal. Cells are medians over seeds; brackets are the least and greatest value, which for five seeds is a 94 %
  interval of the median. Cells without brackets are of one run: the other tools draw nothing from the seed.
- **Defects** are faces that cross others / flipped faces / faces without area that were not in the template; of several
  seeds, the most.
- **Unmatched** is the share of the result's area without a partner on the target.
- **CPU s** are CPU seconds of the fit on one thread, without imports, files and measuring.

| tool | what it was given |
| --- | --- |
| Gauss–Newton | defaults, `connectivity: fixed` |
| first-order | 500 steps of SGD, 3,000 samples, weights of the tutorial |
| pycpd 2.0 | α 10, β 0.6, w 0.02, 100 iterations, 500 points each, the rest carried by its kernel; \
deformable as given and after its rigid stage, of which that with the smaller σ² is kept |
| nricp of trimesh | defaults, but pairs up to a tenth of the diagonal; after rigid ICP, or the best rigid fit to \
the landmarks |
| MeshMonk 0.3 | rigid stage, then its pyramid, 90 iterations, shapes scaled to a diagonal of 100 |
"""


class _Cell(NamedTuple):
    """Results of one method on one pair, by seed, and messages of those that failed."""

    results: list[dict[str, Any]]
    failures: list[str]
    cpu: list[float]

    def values(self, group: str, key: str, scale: float = 1.0) -> list[float]:
        found = (result.get(group, {}) if group else result for result in self.results)
        return [scale * each[key] for each in found if each.get(key) is not None]


_Cells = Mapping[tuple[str, str], _Cell]


def text(runs: Path, pairs: Sequence[Pair], turned: Sequence[str]) -> str:
    """Return the page in Markdown."""
    cells = {(pair.name, method): _cell(runs, pair, method) for pair in pairs for method in _METHODS}
    ran = [method for method in _METHODS if any(_has_run(cells[pair.name, method]) for pair in pairs)]
    parts = [_INTRO, "\n## Vertex error\n"]
    for seen, title in ((True, "Pairs that were looked at"), (False, "Pairs that were not looked at")):
        parts.append(f"\n### {title}\n\n{_errors(cells, [pair for pair in pairs if pair.seen is seen], ran)}")
    parts.append(_random_orientations(runs, turned))
    parts.append(_larger(runs, pairs))
    parts.append("\n## All numbers\n")
    for pair in pairs:
        title = f"{pair.name[0].upper()}{pair.name[1:]}"
        looked = "" if pair.seen else ", not looked at"
        start = 100 * pair.error(pair.source.verts)
        parts.append(
            f"\n### {title}\n\nVertex error at the start: {start:.1f}{looked}.\n\n{_numbers(cells, pair, ran)}"
        )
    return "".join(parts)


def _has_run(cell: _Cell) -> bool:
    return bool(cell.results or cell.failures)


def _errors(cells: _Cells, pairs: Sequence[Pair], methods: Sequence[str]) -> str:
    rows = []
    for pair in pairs:
        row = [cells[pair.name, method] for method in methods]
        middles = [median(cell.values("vertex_error", "rms")) if cell.results else math.inf for cell in row]
        least = min(
            (middle for middle, method in zip(middles, methods, strict=True) if not method.endswith("landmarks")),
            default=math.inf,
        )
        if sum(middle < math.inf for middle in middles) <= 1:
            least = -math.inf  # nothing to compare with
        texts = ["failed" if cell.failures and not cell.results else _error(cell) for cell in row]
        best = [f"**{text}**" if middle <= least else text for text, middle in zip(texts, middles, strict=True)]
        rows.append([pair.name, f"{100 * pair.error(pair.source.verts):.1f}", *best])
    heads = ["pair", "start", *(_METHODS[method] for method in methods)]
    return _table(heads, rows) + "\nBold: the least without landmarks, and what is below it. A dash: not run.\n"


def _numbers(cells: _Cells, pair: Pair, methods: Sequence[str]) -> str:
    rows = []
    for method in methods:
        cell, title = cells[pair.name, method], _METHODS[method]
        if not cell.results:
            if cell.failures:
                rows.append([f"{title}: failed, {cell.failures[0]}", *["–"] * 7])
            continue
        defects = [
            max((int(value) for value in cell.values("new_defects", key)), default=None)
            for key in ("crossing_faces", "flipped_faces", "degenerate_faces")
        ]
        failed = f" ({len(cell.failures)} failed)" if cell.failures else ""
        rows.append(
            [
                f"{title}{failed}",
                str(len(cell.results)),
                _error(cell),
                _middle(cell.values("distance", "forward_rms", 100), 2),
                _middle(cell.values("distance", "backward_rms", 100), 2),
                " / ".join("–" if count is None else str(count) for count in defects),
                _middle(cell.values("unmatched", "source", 100), 1) + " %",
                _middle(cell.cpu, 1),
            ]
        )
    heads = ["method", "seeds", "vertex error", "result→target", "target→result", "defects", "unmatched", "CPU s"]
    missing = [_METHODS[method] for method in methods if not _has_run(cells[pair.name, method])]
    note = f"\nNot run: {'; '.join(missing)}.\n" if missing else ""
    return _table(heads, rows) + note if rows else note.lstrip()


def _random_orientations(runs: Path, turned: Sequence[str]) -> str:
    rows = []
    for name in turned:
        results = [result for _, result in _records(runs / f"turned-{slug(name)}", "result.json")]
        failed = len(list(_records(runs / f"turned-{slug(name)}", "failure.json")))
        total = len(results) + failed
        if not total:
            continue
        errors = sorted(result["vertex_error"]["rms"] for result in results)
        solved = sum(error <= SOLVED for error in errors)
        share = binomtest(solved, total).proportion_ci(method="wilson")
        interval = f"{100 * share.low:.0f} to {100 * share.high:.0f} %"
        middle, worst = (f"{100 * error:.2f}" for error in (median(errors), errors[-1])) if errors else "––"
        rows.append([name, f"{solved} of {total}", interval, middle, worst])
    if not rows:
        return ""
    return (
        "\n## Random orientations\n\nThe template, turned at random, and `register: auto`. Solved: a vertex error of "
        f"at most {100 * SOLVED:.0f} %. The interval is Wilson's, of 95 %.\n\n"
        + _table(["pair", "solved", "interval", "median error", "worst error"], rows)
    )


def _larger(runs: Path, pairs: Sequence[Pair]) -> str:
    rows = []
    for pair in pairs:
        cell = _cell(runs, pair, "auto", "large")
        if not cell.results:
            continue
        crossing = max(int(value) for value in cell.values("new_defects", "crossing_faces"))
        distances = [_middle(cell.values("distance", f"{way}_rms", 100), 2) for way in ("forward", "backward")]
        seconds = _middle(cell.values("seconds", "fit"), 1)
        name = pair.name if pair.seen else f"{pair.name} (not looked at)"
        rows.append([name, str(len(cell.results)), _error(cell), *distances, str(crossing), seconds])
    if not rows:
        return ""
    heads = ["pair", "seeds", "vertex error", "result→target", "target→result", "crossing faces", "seconds"]
    return f"\n## Templates of 8,000 vertices\n\n`register: auto`, as above.\n\n{_table(heads, rows)}"


def _error(cell: _Cell) -> str:
    return _middle(cell.values("vertex_error", "rms", 100), 2, interval=True)


def _middle(values: Sequence[float], digits: int, *, interval: bool = False) -> str:
    if not values:
        return "–"
    middle = f"{median(values):.{digits}f}"
    if not interval or len(values) == 1:
        return middle
    return f"{middle} [{min(values):.{digits}f}, {max(values):.{digits}f}]"


def _cell(runs: Path, pair: Pair, method: str, group: str = "") -> _Cell:
    folder = runs / f"{group or ('ours' if method in _OURS else 'peers')}-{slug(pair.name)}"
    results, cpu = [], []
    for path, result in _records(folder, "result.json"):
        if result["variant"] not in (method, "" if method == "auto" else method):
            continue
        results.append(result)
        stated = re.search(r"CPU seconds: ([\d.]+)", path.with_name("trial.log").read_text(encoding="utf-8"))
        cpu += [float(stated[1])] if stated else []
    measured = runs / "cpu" / f"{slug(pair.name)}-{method}.json"
    if not group and measured.exists():
        cpu.append(json.loads(measured.read_text(encoding="utf-8")))
    failures = [each["message"] for _, each in _records(folder, "failure.json") if each["variant"] == method]
    return _Cell(results, [message.rpartition(": ")[2] for message in failures], cpu)


def _records(folder: Path, name: str) -> Iterator[tuple[Path, dict[str, Any]]]:
    for path in sorted(folder.glob(f"*/*/*/{name}")):
        yield path, json.loads(path.read_text(encoding="utf-8"))


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [heads, ["---", *["--:"] * (len(heads) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
