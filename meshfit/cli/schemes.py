"""`meshfit schemes`: the table of schemes, or one of them with its masks."""

import json
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import AsJson
from meshfit.subdivision.scheme import SchemeEntry


def schemes(
    name: Annotated[
        str | None,
        typer.Argument(
            help="A scheme, as in interp-loop:alpha=0.5, to show its masks.",
            metavar="[SCHEME]",
            autocompletion=completions.schemes,
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """List the subdivision schemes, or show the masks of one.

    Examples:
        meshfit schemes

        meshfit schemes interp-loop:alpha=0.5
    """
    from meshfit.subdivision.table import SCHEMES

    if name is not None:
        return _one(name, as_json)
    if as_json:
        typer.echo(json.dumps([_plain(key, entry) for key, entry in SCHEMES.items()], indent=2))
        return 0
    table = Table(box=None, pad_edge=False)
    for column in ("scheme", "kind", "continuity", "source"):
        table.add_column(column, style="bold" if column == "scheme" else None, overflow="fold")
    for domain in dict.fromkeys(entry.domain for entry in SCHEMES.values()):
        table.add_row(f"\n[not bold italic]on {domain}[/]" if table.row_count else f"[not bold italic]on {domain}[/]")
        for key, entry in SCHEMES.items():
            if entry.domain == domain:
                table.add_row(_with_parameters(key, entry), entry.kind, entry.continuity, entry.source)
    out.print(table)
    out.print("\nParameters follow a colon: [bold]interp-loop:alpha=0.5[/]. Masks: [bold]meshfit schemes NAME[/].")
    return 0


def _one(text: str, as_json: bool) -> int:
    from meshfit.specs import parse_spec
    from meshfit.subdivision.choose import canonical, entry_of, scheme_of
    from meshfit.subdivision.describe import describe

    scheme = scheme_of(text)
    name = parse_spec(text).name
    entry = entry_of(name)
    rows = list(describe(scheme))
    if as_json:
        masks = [{"where": row.where, "weights": row.weights} for row in rows]
        typer.echo(json.dumps(_plain(name, entry) | {"masks": masks}, indent=2))
        return 0
    out.print(f"[bold]{escape(canonical(text))}[/]  {entry.title}, {entry.kind}")
    facts = Table(box=None, pad_edge=False, show_header=False)
    facts.add_column(style="bold")
    facts.add_column()
    told = {"on": entry.domain, "split": scheme.split.value, "continuity": entry.continuity, "source": entry.source}
    for key, value in told.items():
        facts.add_row(key, value)
    for key, parameter in entry.parameters.items():
        allowed = (
            " or ".join(map(str, parameter.allowed))
            if isinstance(parameter.default, str)
            else "{} … {}".format(*parameter.allowed)
        )
        facts.add_row(key, f"{parameter.meaning} ({allowed}; default {parameter.default})")
    for row in rows:
        facts.add_row(row.where, row.weights)
    out.print(facts)
    return 0


def _with_parameters(name: str, entry: SchemeEntry) -> str:
    return name + (f"\n  [not bold]:{', '.join(entry.parameters)}[/]" if entry.parameters else "")


def _plain(name: str, entry: SchemeEntry) -> dict[str, object]:
    parameters = {
        key: {"default": parameter.default, "allowed": list(parameter.allowed), "meaning": parameter.meaning}
        for key, parameter in entry.parameters.items()
    }
    facts = {
        "name": name,
        "title": entry.title,
        "domain": entry.domain,
        "kind": entry.kind,
        "continuity": entry.continuity,
    }
    return facts | {"source": entry.source, "parameters": parameters}
