"""An analysis in words."""

from collections.abc import Iterator, Sequence

from meshfit.subdivision.analysis.analyse import Analysis

_SAME = 1e-6


def verdict(analysis: Analysis) -> str:
    """How smooth the limit is, in one line."""
    where = "" if analysis.domain == "curves" else " on regular meshes"
    bound = f"s2 = {analysis.s2:.3f}"
    if analysis.continuity < 0:
        return f"continuity is not shown{where} ({bound})"
    known = analysis.holder_bound is not None and analysis.continuity + 1 >= analysis.holder_bound - _SAME
    least = "" if known else "at least "
    regular = f"{least}C{analysis.continuity}{where} ({bound})"
    if analysis.continuity < 1:
        return f"{regular}, not C1" if not least else regular
    parts = [regular]
    if analysis.failing:
        parts.append(f"C1 fails at {_named(analysis, analysis.failing)}")
    elif any(place.valence != analysis.regular for place in analysis.places):
        parts.append(f"C1 at {_named(analysis, [place.valence for place in analysis.places])}")
    if analysis.unruled:
        parts.append(f"no rule at {_named(analysis, analysis.unruled)}")
    return "; ".join(parts)


def warnings_of(analysis: Analysis) -> Iterator[str]:
    """For each valence at which C1 fails, though not on regular meshes, why."""
    if analysis.continuity < 1:
        return
    for place in analysis.places:
        if place.fault:
            alpha = analysis.alphas.get(place.valence)
            cure = "" if alpha is None else f"; it holds there for alpha < {alpha:.4f}"
            yield f"C1 fails at {_named(analysis, [place.valence])}: {place.fault}{cure}"


def curvature_of(analysis: Analysis, valence: int) -> str:
    """What becomes of curvatures there: bounded, flat or unbounded; empty where the limit is not C1."""
    place = next(place for place in analysis.places if place.valence == valence)
    return "" if valence in analysis.failing else place.spectrum.curvature


def _named(analysis: Analysis, valences: Sequence[int]) -> str:
    """`valence 3`, `valences 3 and 8 to 12`, or `faces of 3 corners`."""
    runs: list[list[int]] = []
    for valence in valences:
        if runs and valence == runs[-1][-1] + 1:
            runs[-1].append(valence)
        else:
            runs.append([valence])
    parts = [f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs]
    listed = " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else parts[0]
    if analysis.odd == "face":
        return f"faces of {listed} corners"
    return f"valence{'s' if len(valences) > 1 else ''} {listed}"
