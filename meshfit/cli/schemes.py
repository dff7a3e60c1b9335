"""`meshfit schemes`: list the subdivision schemes, show the masks of one, or analyse it."""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import AsJson, SchemeConfig

if TYPE_CHECKING:
    from collections.abc import Iterable

    from meshfit.analysis.analyse import Analysis
    from meshfit.analysis.spectrum import Eigenvalue
    from meshfit.subdivision.describe import MaskRow
    from meshfit.subdivision.registry import Entry, Registry, Scheme


_DIGITS = 12  # further digits of an eigenvalue are rounding
_JSON_KEYS = {"irregular": "odd", "unsupported": "unruled"}
_WIDEST = 24  # characters of the names of schemes; longer ones are folded


def _print_verdict(analysis: "Analysis") -> None:
    """Print one line on the smoothness of the limit."""
    from meshfit.analysis.analyse import verdict

    out.print(f"[bold]{escape(verdict(analysis))}[/]\n")


def _print_analysis(analysis: "Analysis") -> None:
    """Print the properties on regular meshes, one row per valence, the boundary, and warnings."""
    from meshfit.analysis.analyse import warnings_of

    out.print()
    out.print(_properties(analysis))
    if analysis.extraordinary:
        out.print()
        out.print(_valences(analysis))
        out.print("\nλ1 is of mode 1; times: the number of eigenvalues of its modulus; rest: the largest other one.")
    if analysis.boundary:
        out.print()
        out.print(_boundary(analysis))
        out.print("\nIn order: two eigenvalues lead, one of them that of the boundary curve's tangent.")
    for warning in warnings_of(analysis):
        out.print(f"[bold magenta]warning:[/] {escape(warning)}")


def _plain_analysis(analysis: "Analysis") -> dict[str, object]:
    """Return an analysis as plain data for JSON."""
    from meshfit.analysis.analyse import curvature_of, verdict, warnings_of

    numbers = {_JSON_KEYS.get(name, name): value for name, value in asdict(analysis).items()}
    for part in ("extraordinary", "boundary", "alphas"):
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
        for place in analysis.extraordinary
    ]
    lists = {"valences": places, "boundary": boundary, "warnings": list(warnings_of(analysis))}
    return {"verdict": verdict(analysis)} | numbers | lists


def _named_values(rows: "Iterable[tuple[str, str]]") -> Table:
    """Return a table of names in bold, each with its value."""
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="bold")
    table.add_column()
    for name, value in rows:
        table.add_row(name, value)
    return table


def _properties(analysis: "Analysis") -> Table:
    off = max(abs(1 - total) for total in analysis.row_sums)
    support, bound = analysis.support, analysis.holder_bound
    unit = "edge" if analysis.domain == "curves" else "ring"
    low, high = support.stencils
    stencils = f"{low} to {high}" if low < high else f"{high}"
    rows = (
        ("row sums", f"1, within {off:.0e}" if off else "1"),
        ("polynomials", f"reproduced to degree {analysis.reproduced}, generated to degree {analysis.generated}"),
        ("Sobolev exponent", f"{analysis.s2:.4f} in L2"),
        ("Hölder exponent", f"at most {bound:.4f}" if bound is not None else "no bound is known"),
        ("shifts of the basis", "stable" if analysis.stable else "unstable"),
        ("support", f"{support.radius:g} {unit}s around a vertex; stencils of {stencils} vertices"),
        ("dilation", f"{analysis.dilation} after {analysis.steps} level{'s' * (analysis.steps > 1)}"),
    )
    return _named_values(rows)


def _valences(analysis: "Analysis") -> Table:
    from meshfit.analysis.analyse import curvature_of

    table = Table(box=None, pad_edge=False)
    name = "corners" if analysis.irregular == "face" else "valence"
    for column in (name, "λ1", "times", "rest", "mode", "curvature", "map", "C1"):
        table.add_column(column, justify="left" if column in ("curvature", "map", "C1") else "right")
    for place in analysis.extraordinary:
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


def schemes(
    name: Annotated[
        str | None,
        typer.Argument(
            help="A scheme, as in interp-loop:alpha=0.5, or a file that defines one, to show its masks.",
            metavar="SCHEME",
            autocompletion=completions.schemes,
        ),
    ] = None,
    config: SchemeConfig = None,
    analysed: Annotated[
        bool,
        typer.Option(
            "--analyse",
            help="Analyse the smoothness of its limit, on regular meshes and at valences 3 to 12.",
        ),
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", help="Draw the analysis to a .png, .pdf or .svg.", metavar="FILE"),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """List the subdivision schemes, or show or analyse one.

    An analysis computes, from the operators of the scheme: the polynomials that it reproduces and generates, the
    smoothness of its limit on regular meshes, and the eigenvalues and characteristic map at extraordinary vertices.
    The figure requires an extra: pip install 'meshfit[report]'.

    Examples:
        meshfit schemes
        meshfit schemes interp-loop:alpha=0.5
        meshfit schemes four-point  # on curves
        meshfit schemes my-scheme.yaml
        meshfit schemes butterfly --analyse --plot butterfly.png
    """
    if analysed or plot is not None:
        _stay_on_one_thread()
    from meshfit.config.loading import load_definitions
    from meshfit.config.scheme_files import resolve_specs
    from meshfit.errors import ConfigError
    from meshfit.subdivision.registry import registry_with

    specs, own = resolve_specs([] if name is None else [name], load_definitions(config))
    registry = registry_with(own)
    if specs:
        return _show_scheme(specs[0], registry, plot, analysed=analysed, as_json=as_json)
    if analysed or plot is not None:
        option = "--analyse" if analysed else "--plot"
        raise ConfigError(f"{option} is for one scheme: name it, as in `meshfit schemes loop {option}`")
    if as_json:
        typer.echo(json.dumps([_plain_entry(key, entry) for key, entry in registry.items()], indent=2))
        return 0
    table = Table(box=None, pad_edge=False)
    table.add_column("scheme", style="bold", overflow="fold", min_width=min(_WIDEST, max(map(len, registry))))
    for column in ("kind", "continuity", "source"):
        table.add_column(column, overflow="fold")
    domain = None
    for key, entry in registry.items():
        if entry.domain != domain:
            domain = entry.domain
            table.add_row(f"[not bold]on {domain}[/]")
        table.add_row(_with_parameters(key, entry), entry.kind, entry.continuity, entry.source)
    out.print(table)
    out.print("\nParameters follow a colon: [bold]interp-loop:alpha=0.5[/]. Masks: [bold]meshfit schemes NAME[/].")
    return 0


def _show_scheme(spec: str, registry: "Registry", plot: Path | None, *, analysed: bool, as_json: bool) -> int:
    from meshfit.subdivision.describe import describe
    from meshfit.subdivision.registry import canonical, entry_of, resolve, spec_of

    scheme = resolve(spec, registry)
    name, title = spec_of(spec).name, canonical(spec, registry)
    entry = entry_of(name, registry)
    analysis = _analysis(scheme, title, plot) if analysed or plot is not None else None
    rows = list(describe(scheme))
    if as_json:
        data = _plain_entry(name, entry) | {"masks": [{"where": row.where, "weights": row.weights} for row in rows]}
        if analysis is not None:
            data["analysis"] = _plain_analysis(analysis)
        typer.echo(json.dumps(data, indent=2))
        return 0
    if analysis is not None:
        _print_verdict(analysis)
    _print_masks(title, entry, scheme, rows)
    if analysis is not None and analysed:
        _print_analysis(analysis)
    if plot is not None:
        out.print(f"wrote {plot}", soft_wrap=True, markup=False)
    return 0


def _analysis(scheme: "Scheme", title: str, plot: Path | None) -> "Analysis":
    from meshfit.analysis.analyse import analyse

    if plot is None:
        return analyse(scheme)
    from meshfit.analysis.figure import write_analysis
    from meshfit.report.figures.layout import require_suffix

    require_suffix(plot)
    analysis = analyse(scheme)
    write_analysis(scheme, analysis, title, plot)
    return analysis


def _print_masks(title: str, entry: "Entry", scheme: "Scheme", rows: "list[MaskRow]") -> None:
    out.print(f"[bold]{escape(title)}[/]  {entry.title}, {entry.kind}")
    facts = [
        ("refines", entry.domain),
        ("split", scheme.split.value),
        ("continuity", entry.continuity),
        ("source", entry.source),
    ]
    for key, parameter in entry.parameters.items():
        allowed = (
            " or ".join(map(str, parameter.allowed))
            if isinstance(parameter.default, str)
            else "{} … {}".format(*parameter.allowed)
        )
        facts.append((key, f"{parameter.meaning} ({allowed}; default {parameter.default})"))
    out.print(_named_values([*facts, *((row.where, row.weights) for row in rows)]))


def _stay_on_one_thread() -> None:
    """Limit numpy to one thread, before it is imported: for small matrices, threads cost more than they gain."""
    from meshfit.experiment.running.process_pool import ONE_THREAD

    for name, count in ONE_THREAD.items():
        os.environ.setdefault(name, count)


def _with_parameters(name: str, entry: "Entry") -> str:
    return name + (f"\n  [not bold]:{', '.join(entry.parameters)}[/]" if entry.parameters else "")


def _plain_entry(name: str, entry: "Entry") -> dict[str, object]:
    parameters = {
        key: {"default": parameter.default, "allowed": list(parameter.allowed), "meaning": parameter.meaning}
        for key, parameter in entry.parameters.items()
    }
    facts = {"name": name, "title": entry.title, "domain": entry.domain, "kind": entry.kind}
    return facts | {"continuity": entry.continuity, "source": entry.source, "parameters": parameters}
