"""The sentences of a table: its head, its comparisons, and notes on how to read its numbers."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, product
from typing import Any

from meshfit.config.experiment import MADE_FROM_TARGET
from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.grouping import Missing, numbers_in, without_numbers
from meshfit.report.tables.layout import FEWER, NOT_SIGNIFICANT, SHORTFALL, columns_of, row_titles
from meshfit.report.tables.numbers import format_difference
from meshfit.report.tables.paper_numbers import LIKELIER, OTHER, PAPER_METRIC, paper_value
from meshfit.report.tables.provenance import provenance_notes
from meshfit.report.tables.table import VARIED, Comparison, Row, Table
from meshfit.statistics import MOST_SEEDS
from meshfit.units import count_text

FRAMES = {
    "tutorial": "the target's tutorial frame (vertex mean 0, largest |coordinate| 1)",
    "box": "the box frame (centre of the target's bounding box 0, its diagonal 1)",
    "sphere": "the sphere frame (vertex mean 0, farthest vertex of the target at distance 1)",
    "cube": "the cube frame (centre of the target's bounding box 0, its longest side 1)",
    "none": "the unit of the target's file",
}
"""The frame that lengths are stated in, by the setting `normalise`."""
_STAND_IN = "stand-in"
_OF_DISTANCE = ("hausdorff.", "distance.", "chamfer.", "f_score.", "normal_", "edges.")
_COMPARED_WITH = {
    "truth": "distances are to the true mesh, which no fit saw",
    "depth": "distances are to the points of the depth maps",
    "hull": "distances are to the visual hull of the masks, which a good result need not follow; see iou.mean",
}
_MOST_SHORTFALLS, _MOST_ROWS, _MOST_PLACES = 6, 3, 6
_CELLS = {
    "mean": "mean",
    "mean-sd": "mean ± standard deviation",
    "mean-ci": "mean [95 % confidence interval of the mean]",
    "full": "mean (median) [95 % confidence interval of the mean]",
}


# The head of a table.


def metric_line(table: Table) -> str:
    """Name the metrics and the better direction: `Hausdorff distance (smaller is better); Components`."""
    direction = {True: " (smaller is better)", False: " (larger is better)", None: ""}
    return "; ".join(
        f"{_capitalised(table.metric_title(name))}{direction[METRICS[name].smaller_is_better]}"
        for name in table.metrics
    )


def cell_line(table: Table) -> str:
    """Explain the numbers of a cell."""
    seeds = table.seeds
    if len(seeds) == 1:
        return f"Cells: one run with seed {seeds[0]}"
    return f"Cells: {_CELLS[table.style.cells]} over {len(seeds)} seeds ({_listed(seeds)})"


def trial_line(table: Table) -> str:
    """Count the planned trials by state: `Trials: 4 of 6 complete, 2 diverged`; empty if all are complete."""
    if not table.num_missing:
        return ""
    planned, (complete, *others) = sum(table.counts.values()), table.counts.items()
    return f"Trials: {complete[1]} of {planned} complete, {', '.join(f'{count} {state}' for state, count in others)}"


def head_lines(table: Table) -> list[str]:
    """Return the lines above a table, without its settings."""
    return list(filter(None, (metric_line(table), cell_line(table), trial_line(table))))


def setting_lines(table: Table) -> list[str]:
    """State the frame of lengths, the fit, the measurement and the source; empty unless the notes are full."""
    if table.style.notes != "full":
        return []
    settings = table.settings

    def get(key: str) -> str:
        value = settings.get(key)
        return "?" if value is None else str(value)

    measured = f"measured on {get('measure.samples')} samples{_measured_surface(settings)}"
    scheme = f"; scheme {table.scheme_title(table.schemes[0])}" if _one_scheme(table) else ""
    return [
        f"Lengths in {FRAMES.get(get('normalise'), get('normalise'))}",
        f"Fit: {_fit(get)}{_fitted_surface(settings)}; {measured}",
        f"Source: {', '.join(_source(settings, get))}{scheme}",
    ]


def _one_scheme(table: Table) -> bool:
    """Return whether variations of a single scheme are compared."""
    return len(table.variations) > 1 and len(table.schemes) == 1


def _fitted_surface(settings: Mapping[str, Any]) -> str:
    surface = settings.get("target.surface", "all")
    if surface == VARIED:
        return ", to surfaces that vary"
    return ", to the outer surface of each target" if surface == "outer" else ""


def _measured_surface(settings: Mapping[str, Any]) -> str:
    surface = settings.get("measure.surface", "all")
    if surface == VARIED:
        return " of surfaces that vary"
    return " of the outer surfaces, without what they hide" if surface == "outer" else ""


def _fit(get: Callable[[str], str]) -> str:
    if get("fit.method") == VARIED:
        return "by several methods"
    if get("fit.method") == "gauss-newton":
        return f"gauss-newton, {count_text(get('fit.levels'), 'level')}, connectivity {get('fit.connectivity')}"
    if get("fit.method") == "external":
        return _tool(get)
    return f"{count_text(get('fit.steps'), 'step')} of {get('fit.optimizer.name')}, {get('fit.samples')} samples a step"


def _tool(get: Callable[[str], str]) -> str:
    if VARIED in (get("fit.tool"), get("fit.command")):
        return "by several tools"
    command = get("fit.command")
    return get("fit.tool") if command == "?" else f"by the command {command}"


def _source(settings: Mapping[str, Any], get: Callable[[str], str]) -> Iterator[str]:
    mesh = get("source.mesh")
    yield f"made from each target ({mesh})" if mesh in MADE_FROM_TARGET else mesh
    if settings.get("source.decimate"):
        yield f"decimated to {get('source.decimate')} faces"
    vertices = settings.get("source.wanted_verts")
    yield count_text(get("source.levels"), "level") if vertices is None else f"refined to about {vertices} vertices"
    project = settings.get("source.project", "none")
    if project != "none":
        yield f"projection {VARIED}" if project == VARIED else f"projected to the {project}"
    yield from _creases_and_alphas(settings)


def _creases_and_alphas(settings: Mapping[str, Any]) -> Iterator[str]:
    angle, file, sharpness = (settings.get(f"source.creases.{key}") for key in ("angle", "file", "sharpness"))
    if angle is not None or file is not None:
        varied = VARIED in (angle, file)
        where = f"creases {VARIED}" if varied else f"creases of {file}" if file else f"creases above {angle:g} degrees"
        yield where if sharpness is None else f"{where} of sharpness {sharpness}"
    alpha = settings.get("source.alpha.file") or settings.get("source.alpha.attribute")
    if alpha is not None:
        yield f"alpha {VARIED}" if alpha == VARIED else f"alpha of each vertex from {alpha}"


# Comparisons.


@dataclass(frozen=True)
class ComparisonText:
    """A comparison in words.

    Attributes:
        label: names the rows, as far as this is not clear from the context.
        difference: the difference and its interval.
        verdict: whether it is significant, and for how many seeds if not all.
        improvement: probability of improvement, `0.92`; empty for single runs, or if neither direction is better.
        seeds_needed: `3`, or `> 10,000`; empty without an interval or a difference.
        comparison: the comparison itself.
    """

    label: str
    difference: str
    verdict: str
    improvement: str
    seeds_needed: str
    comparison: Comparison


@dataclass(frozen=True)
class Section:
    """Comparisons with the same row, or the same kind of row.

    Attributes:
        title: states what is compared, and with what.
        places: comparisons by place: each target, and all targets together.
    """

    title: str
    places: dict[str, list[ComparisonText]]


def without_intervals(table: Table) -> bool:
    """Return whether there are several comparisons, and none has an interval."""
    return len(table.comparisons) > 1 and not any(comparison.difference.interval for comparison in table.comparisons)


def comparison_lines(table: Table) -> list[str]:
    """Return one line for each comparison, or a single line if none has an interval; none unless notes are full."""
    if table.style.notes != "full":
        return []
    if without_intervals(table):
        return ["Differences: one seed only, so no intervals; run several seeds to compare"]
    lines = []
    for comparison in table.comparisons:
        metric = f"{table.metric_title(comparison.metric)}: " if len(table.metrics) > 1 else ""
        place = _place(table, comparison) if comparison.target is None else f"on {_place(table, comparison)}"
        text = _in_words(table, comparison, _versus(table, comparison))
        seeds = text.seeds_needed.replace("> ", "more than ")
        parts = [text.difference, text.verdict]
        parts += [f"P(better) {text.improvement}"] * bool(text.improvement) + [f"{seeds} seeds needed"] * bool(seeds)
        lines.append(f"{metric}{text.label} {place}: {', '.join(parts)}")
    return lines


def sections_of(table: Table) -> list[Section]:
    """Arrange the comparisons in sections: for each metric, schemes with the baseline, then variations."""
    if table.style.notes != "full":
        return []
    sections = []
    for metric, of_metric in groupby(table.comparisons, key=lambda comparison: comparison.metric):
        prefix = f"{_capitalised(table.metric_title(metric))}: difference" if len(table.metrics) > 1 else "Difference"
        comparisons = list(of_metric)
        for across in (False, True):
            of_kind = [comparison for comparison in comparisons if comparison.across_variations is across]
            if of_kind:
                ending, label = _ending_and_labels(table, of_kind)
                places: dict[str, list[ComparisonText]] = {}
                for comparison in of_kind:
                    text = _in_words(table, comparison, label(comparison))
                    places.setdefault(_place(table, comparison), []).append(text)
                sections.append(Section(prefix + ending, places))
    return sections


def _in_words(table: Table, comparison: Comparison, label: str) -> ComparisonText:
    difference = comparison.difference
    single, better, seeds = difference.interval is None, difference.improvement, difference.seeds_needed
    verdict = {None: "one seed: no interval", True: "significant", False: "not significant"}[difference.significant]
    if not single and difference.count < len(table.seeds):
        verdict += f" ({difference.count} seeds)"
    return ComparisonText(
        label,
        format_difference(difference),
        verdict,
        improvement="" if single or better is None else f"{better:.2f}",
        seeds_needed="" if single or difference.mean == 0 else f"> {MOST_SEEDS:,}" if seeds is None else f"{seeds:,}",
        comparison=comparison,
    )


def _versus(table: Table, comparison: Comparison) -> str:
    """Name both rows: `interp-loop vs loop`, `edge=0.2 vs edge=0.1 with loop`."""
    first, second = comparison.row, comparison.against
    names = [table.variation_title(row) for row in (first, second)]
    if comparison.across_variations:
        scheme = "" if _one_scheme(table) else f" with {table.scheme_title(first.scheme)}"
        return f"{names[0]} vs {names[1]}{scheme}"
    return f"{table.scheme_title(first.scheme)} vs {table.scheme_title(second.scheme)}" + (
        f" at {names[0]}" if names[0] else ""
    )


def _place(table: Table, comparison: Comparison) -> str:
    """Return a target's title, `over 5 targets`, or `over 4 of 5 targets`."""
    if comparison.target is not None:
        return table.targets[comparison.target]
    every, compared = len(table.targets), comparison.difference.targets
    return f"over {every} targets" if compared == every else f"over {compared} of {every} targets"


def _ending_and_labels(table: Table, comparisons: Sequence[Comparison]) -> tuple[str, Callable[[Comparison], str]]:
    """Return the end of a section's title, and a function that labels each comparison by the rest."""
    first = comparisons[0]
    if first.across_variations:
        scheme = f" of {table.scheme_title(first.row.scheme)}" if len(table.schemes) > 1 else ""
        return f"{scheme} from {table.variation_title(first.against)}", lambda each: _variation(table, each)
    if len({each.against.scheme for each in comparisons}) > 1:
        return " from the baseline", lambda each: _versus(table, each)
    if len(table.variations) == 1:
        return f" from {table.scheme_title(first.against.scheme)}", lambda each: table.scheme_title(each.row.scheme)
    ending = f" from {table.scheme_title(first.against.scheme)} at the same settings"
    if len({each.row.scheme for each in comparisons}) == 1:
        return f" of {table.scheme_title(first.row.scheme)}{ending}", lambda each: _variation(table, each)
    return ending, lambda each: f"{_variation(table, each)} · {table.scheme_title(each.row.scheme)}"


def _variation(table: Table, comparison: Comparison) -> str:
    return table.variation_title(comparison.row)


# Notes below a table.


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
    return f"{' · '.join(row_titles(table, row))} on {named} ({noun} {_listed(seeds)})"


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
                    few[f"{name} on {title}: {count_text(len(seeds), 'seed')} ({_listed(seeds)})"] = None
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


def _listed(seeds: Sequence[int]) -> str:
    if len(seeds) > 2 and seeds[-1] - seeds[0] == len(seeds) - 1:
        return f"{seeds[0]}–{seeds[-1]}"
    return ", ".join(map(str, seeds))


def _capitalised(text: str) -> str:
    return text[:1].upper() + text[1:]
