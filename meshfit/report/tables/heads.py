"""The lines above a table: metrics, cells, trials and settings."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from meshfit.config.source_settings import MADE_FROM_TARGET
from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.table import VARIED, Table
from meshfit.units import count_text

FRAMES = {
    "tutorial": "the target's tutorial frame (vertex mean 0, largest |coordinate| 1)",
    "box": "the box frame (centre of the target's bounding box 0, its diagonal 1)",
    "sphere": "the sphere frame (vertex mean 0, farthest vertex of the target at distance 1)",
    "cube": "the cube frame (centre of the target's bounding box 0, its longest side 1)",
    "none": "the unit of the target's file",
}
"""The frame that lengths are stated in, by the setting `normalise`."""
_CELLS = {
    "mean": "mean",
    "mean-sd": "mean ± standard deviation",
    "mean-ci": "mean [95 % confidence interval of the mean]",
    "full": "mean (median) [95 % confidence interval of the mean]",
}


def metric_line(table: Table) -> str:
    """Name the metrics and the better direction: `Hausdorff distance (smaller is better); Components`."""
    direction = {True: " (smaller is better)", False: " (larger is better)", None: ""}
    return "; ".join(
        f"{capitalised(table.metric_title(name))}{direction[METRICS[name].smaller_is_better]}" for name in table.metrics
    )


def cell_line(table: Table) -> str:
    """Explain the numbers of a cell."""
    seeds = table.seeds
    if len(seeds) == 1:
        return f"Cells: one run with seed {seeds[0]}"
    return f"Cells: {_CELLS[table.style.cells]} over {len(seeds)} seeds ({seeds_text(seeds)})"


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
    scheme = f"; scheme {table.scheme_title(table.schemes[0])}" if one_scheme(table) else ""
    return [
        f"Lengths in {FRAMES.get(get('normalise'), get('normalise'))}",
        f"Fit: {_fit(get)}{_fitted_surface(settings)}; {measured}",
        f"Source: {', '.join(_source(settings, get))}{scheme}",
    ]


def one_scheme(table: Table) -> bool:
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


def seeds_text(seeds: Sequence[int]) -> str:
    """Return seeds as text: `0–4`, or `0, 2, 7`."""
    if len(seeds) > 2 and seeds[-1] - seeds[0] == len(seeds) - 1:
        return f"{seeds[0]}–{seeds[-1]}"
    return ", ".join(map(str, seeds))


def capitalised(text: str) -> str:
    """Return a text with its first letter as a capital."""
    return text[:1].upper() + text[1:]
