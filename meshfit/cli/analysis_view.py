"""An analysis of a scheme as it is printed, and as plain data."""

from dataclasses import asdict
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from meshfit.cli.console import out

if TYPE_CHECKING:
    from meshfit.subdivision.analysis.analyse import Analysis
    from meshfit.subdivision.analysis.spectrum import Eigenvalue

_DIGITS = 12  # more of an eigenvalue is rounding


def print_verdict(analysis: "Analysis") -> None:
    """The one line that says how smooth the limit is."""
    from meshfit.subdivision.analysis.verdict import verdict

    out.print(f"[bold]{escape(verdict(analysis))}[/]\n")


def print_analysis(analysis: "Analysis") -> None:
    """What holds on regular meshes, a row for each valence, and what to be warned of."""
    from meshfit.subdivision.analysis.verdict import warnings_of

    out.print()
    out.print(_facts(analysis))
    if analysis.places:
        out.print()
        out.print(_valences(analysis))
        out.print("\nλ1 is of mode 1; times: how many eigenvalues are as large; rest: the largest other one.")
    if analysis.boundary:
        out.print()
        out.print(_boundary(analysis))
        out.print("\nIn order: two eigenvalues lead, and that of the boundary curve's tangent is one of them.")
    for warning in warnings_of(analysis):
        out.print(f"[bold magenta]warning:[/] {escape(warning)}")


def plain_analysis(analysis: "Analysis") -> dict[str, object]:
    """The same as data that JSON can hold."""
    from meshfit.subdivision.analysis.verdict import curvature_of, verdict, warnings_of

    numbers = asdict(analysis)
    for part in ("places", "boundary", "alphas"):
        del numbers[part]
    boundary = [
        {
            "neighbours": place.neighbours,
            "moduli": [round(modulus, _DIGITS) for modulus in place.moduli],
            "in_order": place.in_order,
        }
        for place in analysis.boundary
    ]
    places = [
        {
            "valence": place.valence,
            "lambda1": _plain_eigenvalue(place.spectrum.leading),
            "multiplicity": place.spectrum.multiplicity,
            "rest": _plain_eigenvalue(place.spectrum.rest),
            "curvature": curvature_of(analysis, place.valence) or None,
            "characteristic_map_regular": place.regular_map,
            "c1": place.valence not in analysis.failing,
            "c1_below_alpha": analysis.alphas.get(place.valence),
        }
        for place in analysis.places
    ]
    return (
        {"verdict": verdict(analysis)}
        | numbers
        | {
            "valences": places,
            "boundary": boundary,
            "warnings": list(warnings_of(analysis)),
        }
    )


def _facts(analysis: "Analysis") -> Table:
    facts = Table(box=None, pad_edge=False, show_header=False)
    facts.add_column(style="bold")
    facts.add_column()
    off = max(abs(1 - total) for total in analysis.row_sums)
    support, bound = analysis.support, analysis.holder_bound
    unit = "edge" if analysis.domain == "curves" else "ring"
    low, high = support.stencils
    for what, found in (
        ("row sums", f"1, within {off:.0e}" if off else "1"),
        ("polynomials", f"reproduced to degree {analysis.reproduced}, generated to degree {analysis.generated}"),
        ("Sobolev exponent", f"{analysis.s2:.4f} in L2"),
        ("Hölder exponent", f"at most {bound:.4f}" if bound is not None else "no bound is known"),
        ("shifts of the basis", "stable" if analysis.stable else "unstable"),
        (
            "support",
            f"{support.radius:g} {unit}s about a vertex; stencils of {f'{low} to ' * (low < high)}{high} verts",
        ),
        ("dilation", f"{analysis.dilation} after {analysis.steps} level{'s' * (analysis.steps > 1)}"),
    ):
        facts.add_row(what, found)
    return facts


def _valences(analysis: "Analysis") -> Table:
    from meshfit.subdivision.analysis.verdict import curvature_of

    table = Table(box=None, pad_edge=False)
    name = "corners" if analysis.odd == "face" else "valence"
    for column in (name, "λ1", "times", "rest", "mode", "curvature", "map", "C1"):
        table.add_column(column, justify="left" if column in ("curvature", "map", "C1") else "right")
    for place in analysis.places:
        spectrum, smooth = place.spectrum, place.valence not in analysis.failing
        table.add_row(
            f"{place.valence}",
            f"{spectrum.leading.modulus:.4f}",
            f"{spectrum.multiplicity}",
            f"{spectrum.rest.modulus:.4f}",
            f"{spectrum.rest.mode}",
            curvature_of(analysis, place.valence) or "–",
            "regular" if place.regular_map else "folds",
            "yes" if smooth else "[bold magenta]no[/]",
        )
    return table


def _boundary(analysis: "Analysis") -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("neighbours on a boundary", "largest eigenvalues", "in order"):
        table.add_column(column, justify="right" if column.startswith("n") else "left")
    for place in analysis.boundary:
        order = "yes" if place.in_order else "[bold magenta]no[/]"
        table.add_row(f"{place.neighbours}", ", ".join(f"{modulus:.4f}" for modulus in place.moduli), order)
    return table


def _plain_eigenvalue(eigenvalue: "Eigenvalue") -> dict[str, float | int]:
    value, digits = eigenvalue.value, _DIGITS
    parts = {"modulus": abs(value), "real": value.real, "imaginary": value.imag}
    return {name: round(part, digits) + 0.0 for name, part in parts.items()} | {"mode": eigenvalue.mode}
