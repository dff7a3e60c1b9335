"""What `--help` prints: usage, what a command does, examples of it, and its options in groups."""

import inspect
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rich.text import Text
from typer.core import TyperCommand, TyperGroup

from meshfit.cli.console import out

_ARGUMENTS, _OPTIONS = "Arguments", "Options"
_INDENT, _GAP = 2, 2
_WIDEST_NAME = 26
_WIDEST = 110
_FEWEST_IN_GROUPS = 6

Pairs = Sequence[tuple[str, str]]
"""Names and what they mean."""


@dataclass(frozen=True)
class Description:
    """A docstring taken apart.

    Attributes:
        paragraphs: what a command does, the first in one sentence.
        examples: command lines, each with a comment or without.
    """

    paragraphs: tuple[str, ...]
    examples: tuple[str, ...]

    @classmethod
    def of(cls, docstring: str) -> "Description":
        """Examples are the indented lines below `Example:` or `Examples:`."""
        blocks = inspect.cleandoc(docstring).split("\n\n")
        start = next((at for at, block in enumerate(blocks) if block.startswith("Example")), len(blocks))
        lines = [line.strip() for block in blocks[start:] for line in block.splitlines()[block.startswith("Example") :]]
        return cls(tuple(" ".join(block.split()) for block in blocks[:start]), tuple(filter(None, lines)))


class Command(TyperCommand):
    """A command whose help is laid out here."""

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401, ARG002  Typer's types are not public
        """Print it."""
        arguments = [param for param in self.get_params(ctx) if param.param_type_name == "argument"]
        places = [_shown_value(param) for param in arguments]
        _print_head(" ".join([ctx.command_path, *places, "[OPTIONS]"]), Description.of(self.help or ""))
        _print_pairs(_ARGUMENTS, [(_shown_value(param), _meaning(param)) for param in arguments])
        _print_options(self.get_params(ctx))


class Group(TyperGroup):
    """The command that all others are part of."""

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401, ARG002  likewise
        """Print it."""
        _print_head(f"{ctx.command_path} COMMAND ...", Description.of(self.help or ""))
        panels: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command: Any = self.get_command(ctx, name)
            first = Description.of(command.help or "").paragraphs[0]
            panels.setdefault(command.rich_help_panel, []).append((name, first))
        widest = max(len(name) for pairs in panels.values() for name, _ in pairs)
        for panel, pairs in panels.items():
            _print_pairs(panel, pairs, least=widest)
        _print_options(self.get_params(ctx))


def print_examples(lines: Iterable[str], heading: str = "Examples") -> None:
    """Command lines that can be copied, comments beside them where these fit, else above."""
    out.print(Text(f"\n{heading}", "bold"))
    parts = [[part.strip() for part in line.partition("  # ")[::2]] for line in lines]
    commented = [(line, comment) for line, comment in parts if comment]
    widest = max((len(line) for line, _ in commented), default=0)
    if any(not _fits(widest, comment) for _, comment in commented):
        widest = 0
    for line, comment in parts:
        beside = comment and _fits(max(widest, len(line)), comment)
        if comment and not beside:
            _print_line(Text(f"# {comment}"))
        _print_line(Text.assemble((line, "cyan"), f"{' ' * (widest - len(line))}  # {comment}" if beside else ""))


def _fits(width: int, comment: str) -> bool:
    return _INDENT + width + len("  # ") + len(comment) <= _width()


def _print_line(text: Text) -> None:
    out.print(Text.assemble(" " * _INDENT, text), soft_wrap=True)


def _print_head(usage: str, description: Description) -> None:
    out.print(Text.assemble(("Usage: ", "bold"), usage), soft_wrap=True)
    for paragraph in description.paragraphs:
        out.print()
        for line in textwrap.wrap(paragraph, _width(), break_on_hyphens=False):
            out.print(Text(line))
    if description.examples:
        print_examples(description.examples)


def _print_options(params: Sequence[Any]) -> None:
    panels: dict[str, list[tuple[str, str]]] = {}
    for param in params:
        if param.param_type_name == "option" and not getattr(param, "hidden", False):
            panel = getattr(param, "rich_help_panel", None) or _OPTIONS
            panels.setdefault(panel, []).append((_shown_option(param), _meaning(param)))
    others = panels.pop(_OPTIONS, [])
    every = [pair for pairs in [*panels.values(), others] for pair in pairs]
    groups = {**panels, _OPTIONS: others} if len(every) >= _FEWEST_IN_GROUPS else {_OPTIONS: every}
    widest = min(_WIDEST_NAME, max(len(name) for name, _ in every))
    for panel, pairs in groups.items():
        _print_pairs(panel, pairs, least=widest)


def _print_pairs(heading: str, pairs: Pairs, least: int = 0) -> None:
    if not pairs:
        return
    out.print(Text(f"\n{heading}", "bold"))
    width = max(least, *(len(name) for name, _ in pairs if len(name) <= _WIDEST_NAME), 0)
    for name, meaning in pairs:
        for line in _entry(name, meaning, width):
            _print_line(line)


def _entry(name: str, meaning: str, width: int) -> Iterator[Text]:
    """A name, and beside it its meaning; below it where the name is too long for that."""
    lines = textwrap.wrap(meaning, _width() - _INDENT - width - _GAP, break_on_hyphens=False) or [""]
    if len(name) > width:
        yield Text(name, "cyan")
    else:
        first = lines.pop(0)
        yield Text.assemble((name, "cyan"), " " * (width + _GAP - len(name)), first)
    yield from (Text(" " * (width + _GAP) + line) for line in lines)


def _shown_option(param: Any) -> str:  # noqa: ANN401  likewise
    """`--jobs -j N`."""
    names = sorted([*param.opts, *param.secondary_opts], key=lambda name: not name.startswith("--"))
    return " ".join([*names, _shown_value(param)] if not _is_flag(param) else names)


def _is_flag(param: Any) -> bool:  # noqa: ANN401  likewise
    return bool(getattr(param, "is_flag", False)) or param.name == "help"


def _shown_value(param: Any) -> str:  # noqa: ANN401  likewise
    return str(param.metavar or param.name.upper())


def _meaning(param: Any) -> str:  # noqa: ANN401  likewise
    """What it is for, and what it is where it is not given."""
    text = " ".join((param.help or "").split())
    shown = param.show_default
    default = shown if isinstance(shown, str) else param.default
    if not shown or default in (None, False, [], ()) or _is_flag(param) or param.required:
        return text
    return f"{text} Default: {getattr(default, 'value', default)}."


def _width() -> int:
    return min(out.width, _WIDEST)
