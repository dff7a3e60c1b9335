"""Notes below a table: how to read its numbers."""

from collections.abc import Iterator, Sequence
from itertools import product

from meshfit.report.tables.grouping import Missing, numbers_in, without_numbers
from meshfit.report.tables.heads import seeds_text
from meshfit.report.tables.layout import FEWER, NOT_SIGNIFICANT, SHORTFALL, columns_of, row_titles
from meshfit.report.tables.paper_numbers import LIKELIER, OTHER, PAPER_METRIC, paper_value
from meshfit.report.tables.provenance import provenance_notes
from meshfit.report.tables.table import Row, Table
from meshfit.units import count_text

_STAND_IN = "stand-in"
_OF_DISTANCE = ("hausdorff.", "distance.", "chamfer.", "f_score.", "normal_", "edges.")
_COMPARED_WITH = {
    "truth": "distances are to the true mesh, which no fit saw",
    "depth": "distances are to the points of the depth maps",
    "hull": "distances are to the visual hull of the masks, which a good result need not follow; see iou.mean",
}
_MOST_SHORTFALLS, _MOST_ROWS, _MOST_PLACES = 6, 3, 6


def best_note(table: Table) -> str:
    """Explain the mark of the best cell of a column; empty if no cell has it."""
    if not table.best:
        return ""
    line, across = ("row", "column") if table.style.transpose else ("column", "row")
    other = "scheme" if len(table.variations) == 1 else across
    return f"best of its {line}, significantly better than every other {other}"


def not_significant_note(table: Table) -> str:
    """Explain the mark of cells without a significant difference; empty if no cell has it."""
    against = {
        comparison.against
        for comparison in table.comparisons
        if comparison.difference.significant is False and comparison.target is not None
    }
    if not against:
        return ""
    single = len(against) == 1 and len(table.variations) == 1
    if single:
        return f"not significantly different from {table.scheme_title(against.pop().scheme)}"
    return f"not significantly different from the {'column' if table.style.transpose else 'row'} it is compared with"


def shortfall_note(table: Table) -> str:
    """Explain the mark of cells whose results lack something of their target; empty if no cell has it.

    Shortfalls of a target that differ in numbers alone are stated once, by the worst.
    """
    found: dict[tuple[str, str], list[tuple[Row, str]]] = {}
    for target, row in product(table.targets, table.rows):
        for texts in table.shortfalls(target, row).values():
            for text in texts:
                found.setdefault((target, without_numbers(text)), []).append((row, text))
    more = len(found) - _MOST_SHORTFALLS
    by_place: dict[str, list[str]] = {}
    for (target, _), cases in list(found.items())[:_MOST_SHORTFALLS]:
        by_place.setdefault(_place_of(table, target, cases), []).append(_worst(table, target, cases))
    parts = [f"on {place}, {'; '.join(texts)}" for place, texts in by_place.items()]
    parts += [f"and {more} more, see result.json"] if more > 0 else []
    return f"falls short of its target: {'; '.join(parts)}" if parts else ""


def _place_of(table: Table, target: str, cases: Sequence[tuple[Row, str]]) -> str:
    """Return the target of a shortfall, with the rows that have it unless all do."""
    rows = list(dict.fromkeys(row for row, _ in cases))
    if len(rows) == sum(bool(_seeds(table, target, row)) for row in table.rows):
        return table.targets[target]
    names = [" · ".join(row_titles(table, row)) for row in rows[:_MOST_ROWS]]
    more = len(rows) - _MOST_ROWS
    return f"{table.targets[target]} ({', '.join([*names, *([f'{more} more'] if more > 0 else [])])})"


def _worst(table: Table, target: str, cases: Sequence[tuple[Row, str]]) -> str:
    """Return the worst text of a shortfall, with the number of runs that have it where that is not clear."""
    runs = sum(len(_seeds(table, target, row)) for row in {row for row, _ in cases})
    worst = "worst of " if len({text for _, text in cases}) > 1 else ""
    share = f"{len(cases)} of {runs} runs" if len(cases) < runs else f"{runs} runs" if worst else ""
    return max((text for _, text in cases), key=numbers_in) + (f" ({worst}{share})" if share else "")


def _seeds(table: Table, target: str, row: Row) -> set[int]:
    return {seed for metric in table.metrics for seed in table.samples.get((metric, target, row), ())}


def fewer_note(table: Table) -> str:
    """Explain the mark of cells over fewer runs than planned; empty if no cell has it."""
    if any(table.missing(target, row) for _, target, row in table.cells):
        return "over fewer runs than planned, as others are missing"
    return ""


def _missing_runs(table: Table) -> Iterator[str]:
    """Name the planned trials without a result, one line for each state and message."""
    found: dict[tuple[str, str], dict[tuple[str, Row], dict[int, Missing]]] = {}
    for target, row in product(table.targets, table.rows):
        for seed, missing in table.missing(target, row).items():
            cells = found.setdefault((missing.state, without_numbers(missing.message)), {})
            cells.setdefault((target, row), {})[seed] = missing
    for (state, _), cells in sorted(found.items(), key=lambda case: list(table.counts).index(case[0][0])):
        every = [missing for by_seed in cells.values() for missing in by_seed.values()]
        messages = list(dict.fromkeys(missing.message for missing in every))
        runs = len(every)
        by_row: dict[tuple[Row, tuple[int, ...]], list[str]] = {}
        for (target, row), by_seed in cells.items():
            by_row.setdefault((row, tuple(sorted(by_seed))), []).append(target)
        places = [_place_of_runs(table, row, seeds, targets) for (row, seeds), targets in by_row.items()]
        more = len(places) - _MOST_PLACES
        places = places[:_MOST_PLACES] + ([f"and {more} more"] if more > 0 else [])
        reason = f"; {messages[0].rstrip('.')}" if messages[0] else ""
        reason += " in the first" if len(messages) > 1 else ""
        reason += f"; {'log' if runs == 1 else 'log of the first'}: {every[0].log}" if every[0].log else ""
        yield f"Missing, {state}: {count_text(runs, 'run')}, {'; '.join(places)}{reason}"


def _place_of_runs(table: Table, row: Row, seeds: Sequence[int], targets: Sequence[str]) -> str:
    titles = [table.targets[target] for target in targets[:_MOST_PLACES]]
    more = len(targets) - len(titles)
    named = "every target" if len(targets) == len(table.targets) > 1 else ", ".join(titles)
    named += f" and {more} more" if more > 0 and named != "every target" else ""
    noun = "seed" if len(seeds) == 1 else "seeds"
    return f"{' · '.join(row_titles(table, row))} on {named} ({noun} {seeds_text(seeds)})"


def legend(table: Table, best: str) -> list[tuple[str, str]]:
    """Return the marks that cells have, each with its explanation.

    Args:
        table: the table.
        best: mark of the best cell of a column.
    """
    marks = [(best, best_note(table))]
    if table.style.notes != "none":
        marks.append((NOT_SIGNIFICANT, not_significant_note(table)))
        marks.append((SHORTFALL, shortfall_note(table)))
        marks.append((FEWER, fewer_note(table)))
    return [(mark, note) for mark, note in marks if note]


def notes(table: Table) -> list[str]:
    """Return what a reader has to know to interpret the numbers; the short notes leave out what all tables share."""
    if table.style.notes == "none":
        return []
    origin = provenance_notes(variation.provenance for variation in table.variations)
    first = [*_missing_runs(table), *origin, *_few_seeds(table)]
    if table.style.notes == "short":
        return [*first, *_significance(table), *_about_targets(table)]
    return [*first, *_about_comparisons(table), *_about_targets(table), *_about_paper(table)]


def _few_seeds(table: Table) -> Iterator[str]:
    few: dict[str, None] = {}
    once: dict[str, None] = {}
    for row in table.rows:
        if _runs_once(table, row):
            once[table.variation_title(row) or table.scheme_title(row.scheme)] = None
            continue
        variation, scheme = table.variation_title(row), table.scheme_title(row.scheme)
        for target, title in table.targets.items():
            for metric in table.metrics:
                seeds = sorted(table.samples.get((metric, target, row), {}))
                if seeds and len({*seeds, *table.missing(target, row)}) < len(table.seeds):
                    name = f"{scheme} at {variation}" if variation else scheme
                    few[f"{name} on {title}: {count_text(len(seeds), 'seed')} ({seeds_text(seeds)})"] = None
    if few:
        yield f"Fewer seeds: {'; '.join(few)}"
    if once and len(table.seeds) > 1:
        yield f"Without random numbers, and so run once: {', '.join(once)}"


def _runs_once(table: Table, row: Row) -> bool:
    """Return whether another tool made a row, and only with the first seed, on which it does not depend."""
    settings = table.variations[row.variation].settings
    seeds = {seed for (_, _, of), by_seed in table.samples.items() if of == row for seed in by_seed}
    return settings.get("fit.method") == "external" and seeds == set(table.seeds[:1])


def _significance(table: Table) -> Iterator[str]:
    if any(comparison.difference.interval is not None for comparison in table.comparisons):
        yield "Significance: 95 % confidence intervals of differences paired by seed"


def _about_comparisons(table: Table) -> Iterator[str]:
    comparisons = [comparison for comparison in table.comparisons if comparison.difference.interval is not None]
    if not comparisons:
        return
    yield (
        "Differences are paired by seed. Significant: the 95 % confidence interval excludes 0, as it does by chance "
        "for 1 in 20 pairs of equal schemes"
    )
    if any(comparison.target is None for comparison in comparisons):
        yield "Over targets: mean of the differences on each; its interval is for other seeds, not for other targets"
    if any(comparison.difference.improvement is not None for comparison in comparisons):
        yield "P(better): share of pairs of runs in which the first is better, ties half"
    yield "Seeds needed: on each target, for significance in 4 of 5 experiments"


_TO_POINTS = (
    *("hausdorff.forward", "hausdorff.symmetric", "hausdorff.percent", "distance.mean", "distance.rms"),
    *("distance.forward", "chamfer.", "f_score."),
)
"""The starts of the names of metrics that depend on distances from the result to a target of points."""


def _stand_ins(table: Table) -> Iterator[str]:
    own_titles = [title for variation in table.variations for title in variation.targets.items()]
    for target in dict.fromkeys(target for target, title in own_titles if _STAND_IN in title):
        title = table.targets[target]
        yield f"{title}: replaces the paper's model, which is not public; not comparable with the paper's numbers"


def _about_targets(table: Table) -> Iterator[str]:
    yield from _stand_ins(table)
    yield from _about_clouds(table)
    yield from _about_images(table)


def _about_clouds(table: Table) -> Iterator[str]:
    """Say what numbers of clouds of points mean, where the table has such numbers."""
    clouds = {target: cloud for target, cloud in table.clouds.items() if target in table.targets}
    if not clouds:
        return
    sizes = (f"{table.targets[target]} ({count_text(cloud['points'], 'point')})" for target, cloud in clouds.items())
    text = f"Points: {', '.join(sizes)}"
    if any(metric.startswith(_TO_POINTS) for metric in table.metrics):
        apart = ", ".join(dict.fromkeys(f"{cloud['spacing']:.2g}" for cloud in clouds.values()))
        text += f"; distances to them are to the nearest, and too large by a share of their spacing, about {apart}"
    missing = {"edges.": "creases of points are not known"}
    if any(cloud["normals"] == "estimated" for cloud in clouds.values()):
        missing["normal_consistency.signed"] = "estimated normals have no side"
    reasons = [reason for start, reason in missing.items() if any(metric.startswith(start) for metric in table.metrics)]
    yield text + (f"; missing: {', and '.join(reasons)}" if reasons else "")


def _about_images(table: Table) -> Iterator[str]:
    """Say what distances of targets of images are to, and which views their masks are compared in."""
    images = {target: facts for target, facts in table.images.items() if target in table.targets}
    if any(metric.startswith(_OF_DISTANCE) for metric in table.metrics):
        for kind, text in _COMPARED_WITH.items():
            titles = [table.targets[target] for target, facts in images.items() if facts["compared_with"] == kind]
            if titles:
                yield f"Images: {', '.join(titles)}: {text}"
    counts = dict.fromkeys(facts["held_out"] for facts in images.values())
    if any(metric.startswith("iou.held_out") for metric in table.metrics):
        yield f"Views held out, which no fit saw: {', '.join(f'{count:,}' for count in counts)}"


def _about_paper(table: Table) -> Iterator[str]:
    if PAPER_METRIC not in table.metrics:
        return
    likelier, other = (
        "; ".join(
            f"{table.style.label(target)} {table.scheme_title(scheme)} {value}"
            for target in table.targets
            for scheme in table.schemes
            if (value := paper_value(target, scheme, reading)) is not None
        )
        for reading in (LIKELIER, OTHER)
    )
    if likelier:
        shown = "shown" if any(column.paper for column in columns_of(table)) else likelier
        yield (
            "The paper's numbers are those of its Table 1, one run each, settings not all known. Its columns can be "
            f"read in two ways: {LIKELIER}, the likelier: {shown}; {OTHER}: {other}"
        )
