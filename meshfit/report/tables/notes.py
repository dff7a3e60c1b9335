"""What is said above and below a table: what its numbers are, and what to bear in mind."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.layout import columns, row_names
from meshfit.report.tables.paper_numbers import LIKELIER, OTHER, PAPER_METRIC, paper_value
from meshfit.report.tables.sheet import VARIED, Sheet

FRAMES = {
    "tutorial": "the target's tutorial frame (mean of verts 0, largest |coordinate| 1)",
    "box": "the box frame (centre of the target's bounding box at 0, its diagonal 1)",
    "none": "the unit of the target's file",
}
_STAND_IN = "stand-in"


def best_note(sheet: Sheet) -> str:
    """What follows the mark of the best, whichever mark a format has for it; nothing where none is marked."""
    other = "scheme" if len(sheet.variations) == 1 else "row"
    return f"best of its column, and significantly so against each other {other}" if sheet.best else ""


def not_significant_note(sheet: Sheet) -> str:
    """What follows the mark of cells that do not differ significantly; nothing where none is marked."""
    alike = [one for one in sheet.contrasts if one.paired.significant is False and one.target is not None]
    if not alike:
        return ""
    against = {one.against for one in alike}
    rival = alike[0].against.scheme if len(against) == 1 and len(sheet.variations) == 1 else "what it is compared with"
    return f"not significantly different from {rival}"


def metric_line(sheet: Sheet) -> str:
    """The metrics, and which way is better: `Hausdorff distance (smaller is better); F-score (larger is better)`."""
    words = {True: " (smaller is better)", False: " (larger is better)", None: ""}
    found = [METRICS[name] for name in sheet.metrics]
    return "; ".join(f"{_capital(metric.title)}{words[metric.smaller_is_better]}" for metric in found)


def cell_line(sheet: Sheet) -> str:
    """What a cell is."""
    seeds = sheet.seeds
    if len(seeds) == 1:
        return f"Cells: one run with seed {seeds[0]}"
    return f"Cells: mean (median) [95 % bootstrap interval of the mean] over {len(seeds)} seeds ({_listed(seeds)})"


def setting_lines(sheet: Sheet) -> list[str]:
    """The frame of lengths, the fit, the measurement and the source."""
    found = {key: "?" if value is None else value for key, value in sheet.settings.items()}

    def get(key: str) -> str:
        return str(found.get(key, "?"))

    wanted = sheet.settings.get("source.wanted_verts")
    size = _count(get("source.levels"), "level") if wanted is None else f"refined to about {wanted} verts"
    source = [get("source.mesh"), size]
    if sheet.settings.get("source.decimate"):
        source.insert(1, f"decimated to {get('source.decimate')} faces")
    if sheet.settings.get("source.project", "none") != "none":
        project = get("source.project")
        source.append(f"projection {VARIED}" if project == VARIED else f"projected to the {project}")
    source += _tags(sheet.settings)
    scheme = f"; scheme {sheet.schemes[0]}" if row_names(sheet) == ("variation",) else ""
    return [
        f"Lengths in {FRAMES.get(get('normalise'), get('normalise'))}",
        f"Fit: {_fit(get)}; measured on {get('measure.samples')} samples",
        f"Source: {', '.join(source)}{scheme}",
    ]


def _tags(settings: Mapping[str, Any]) -> Iterator[str]:
    """The creases of a source, and the alphas of its verts, where it has such."""
    angle, file, sharpness = (settings.get(f"source.creases.{key}") for key in ("angle", "file", "sharpness"))
    if angle is not None or file is not None:
        varied = VARIED in (angle, file)
        where = f"creases {VARIED}" if varied else f"creases of {file}" if file else f"creases above {angle:g} degrees"
        yield where if sharpness is None else f"{where} of sharpness {sharpness}"
    alpha = settings.get("source.alpha.file") or settings.get("source.alpha.attribute")
    if alpha is not None:
        yield f"alpha {VARIED}" if alpha == VARIED else f"alpha of each vertex from {alpha}"


def _fit(get: Callable[[str], str]) -> str:
    if get("fit.method") == VARIED:
        return "by several methods"
    if get("fit.method") == "gauss-newton":
        return f"gauss-newton, {_count(get('fit.levels'), 'level')}, connectivity {get('fit.connectivity')}"
    return f"{_count(get('fit.steps'), 'step')} of {get('fit.optimizer.name')}, {get('fit.samples')} samples a step"


def notes(sheet: Sheet) -> list[str]:
    """What a reader has to know to read the numbers rightly."""
    found = [few_seeds(sheet), *_differences(sheet), *_stand_ins(sheet), _paper(sheet)]
    return [note for note in found if note]


def few_seeds(sheet: Sheet) -> str:
    """Which cells have fewer seeds than others; nothing where none has."""
    short = [
        f"{row.scheme}{' at ' if sheet.variations[row.variation] else ''}{sheet.variations[row.variation]} on {title}: "
        f"{_count(str(len(sample)), 'seed')} ({_listed(sorted(sample))})"
        for row in sheet.rows
        for target, title in sheet.targets.items()
        for sample in [sheet.sample(metric, target, row) for metric in sheet.metrics]
        if sample and len(sample) < len(sheet.seeds)
    ]
    return f"Fewer seeds: {'; '.join(dict.fromkeys(short))}" if short else ""


def _differences(sheet: Sheet) -> Iterator[str]:
    found = [contrast for contrast in sheet.contrasts if contrast.paired.interval is not None]
    if not found:
        return
    yield (
        "Differences are paired by seed, with 95 % bootstrap intervals; one whose interval holds 0 is not significant. "
        "Each is taken by itself: of twenty pairs of equal schemes, one is expected to seem different"
    )
    if any(contrast.target is None for contrast in found):
        yield (
            "Over targets: the mean of the differences on each, which count alike; its interval is for other seeds on "
            "the same targets, and not for other targets"
        )
    better = "P(better): share of all pairs of runs in which the one named first is better, a tie counting a half. "
    yield (
        f"{better if any(contrast.paired.improvement is not None for contrast in found) else ''}"
        "Seeds needed: with so many on each target, such a difference is found significant in 4 of 5 experiments"
    )


def _stand_ins(sheet: Sheet) -> list[str]:
    return [
        f"{title}: made by this project in place of the paper's model, which is not public; "
        "its numbers cannot be compared with the paper's"
        for title in stand_ins(sheet)
    ]


def stand_ins(sheet: Sheet) -> list[str]:
    """The titles of targets that stand in for the paper's."""
    return [title for title in sheet.targets.values() if _STAND_IN in title]


def paper_numbers(sheet: Sheet, reading: str) -> str:
    """The paper's numbers for what is in a sheet, in one reading of its table; nothing where it has none."""
    if PAPER_METRIC not in sheet.metrics:
        return ""
    found = [
        f"{target} {scheme} {value}"
        for target in sheet.targets
        for scheme in sheet.schemes
        if (value := paper_value(target, scheme, reading)) is not None
    ]
    return "; ".join(found)


def _paper(sheet: Sheet) -> str:
    likelier, other = (paper_numbers(sheet, reading) for reading in (LIKELIER, OTHER))
    if not likelier:
        return ""
    beside = any(column.paper for column in columns(sheet))
    first = f"shown {LIKELIER}, the likelier" if beside else f"{LIKELIER}, the likelier, they are {likelier}"
    return (
        "The paper's numbers are those of its Table 1, one run each, its settings not all known. Its columns can be "
        f"read in two ways: {first}; {OTHER} they are {other}"
    )


def _listed(seeds: Sequence[int]) -> str:
    if len(seeds) > 2 and seeds[-1] - seeds[0] == len(seeds) - 1:
        return f"{seeds[0]}–{seeds[-1]}"
    return ", ".join(map(str, seeds))


def _count(number: str, noun: str) -> str:
    return f"{number} {noun}" if number == "1" else f"{number} {noun}s"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def brief_notes(sheet: Sheet) -> list[str]:
    """What a reader has to know to read the numbers rightly, a line or two each."""
    return [
        note
        for note in (few_seeds(sheet), *_differences_brief(sheet), *_stand_ins_brief(sheet), _paper_brief(sheet))
        if note
    ]


def _differences_brief(sheet: Sheet) -> Iterator[str]:
    found = [contrast for contrast in sheet.contrasts if contrast.paired.interval is not None]
    if not found:
        return
    yield "significant: the interval is clear of 0; so is that of 1 in 20 equal pairs"
    if any(contrast.target is None for contrast in found):
        yield "over targets: the mean; its interval is for other seeds, not other targets"
    if any(contrast.paired.improvement is not None for contrast in found):
        yield "P(better): share of pairs of runs in which the one named is better, ties half"
    yield "seeds needed: to find such a difference significant in 4 of 5 experiments"


def _stand_ins_brief(sheet: Sheet) -> list[str]:
    return [f"{title}: not the paper's model, nor comparable with its numbers" for title in stand_ins(sheet)]


def _paper_brief(sheet: Sheet) -> str:
    likelier, other = (paper_numbers(sheet, reading) for reading in (LIKELIER, OTHER))
    if not likelier:
        return ""
    said = "shown" if any(column.paper for column in columns(sheet)) else f"they are {likelier}"
    return (
        "paper's: its Table 1, one run each, settings not all known; read "
        f"{LIKELIER}, the likelier, {said}; {OTHER} {other}"
    )
