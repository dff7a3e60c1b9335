"""What a newcomer reads: the first screen, `--help` of every command, and examples that are what they seem."""

import re
import shlex

import pytest
import typer
from meshfit.cli.help import Description

from meshfit.cli import console, main
from tests.cli import answered, refused

GROUP = typer.main.get_command(main.app)
COMMANDS = tuple(GROUP.commands)


def examples(text):
    return Description.of(text).examples


def parsed(line):
    """The command lines within a line of shell, each taken apart by the command that it is for."""
    words = shlex.split(line, comments=True)
    starts = [at for at, word in enumerate(words) if word == "meshfit"]
    found = []
    for start, end in zip(starts, [*starts[1:], len(words)], strict=True):
        own = words[start + 1 : end]
        own = own[: next((at for at, word in enumerate(own) if word in ("&&", ">", "|")), len(own))]
        found.append(own)
        if own == ["--help"]:
            continue
        command = GROUP.commands[own[0]]
        if own[1:] != ["--help"]:
            command.make_context(own[0], own[1:])
    return found


@pytest.fixture(params=[80, 120])
def width(request, monkeypatch):
    monkeypatch.setattr(console.out, "_width", request.param)
    monkeypatch.setattr("tests.cli.WIDTH", request.param)
    return request.param


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_are_command_lines_that_parse(command):
    found = [own for line in examples(GROUP.commands[command].help) for own in parsed(line)]
    assert command in [own[0] for own in found]


def test_the_first_examples_parse_too():
    assert len([own for line in examples(main.HELP) for own in parsed(line)]) > 2
    lines = [line for line in answered().splitlines() if line.startswith("  meshfit ")]
    assert ["run", "quickstart"] in [own for line in lines if "--install" not in line for own in parsed(line)]


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_fits_its_width_and_names_every_option(command, width):
    out = answered(*filter(None, [command]), "--help")
    assert max(map(len, out.splitlines())) <= width
    assert not re.search(r"[ \t]$", out, flags=re.MULTILINE)
    params = GROUP.commands[command].params if command else GROUP.params
    for option in (name for param in params if param.param_type_name == "option" for name in param.opts):
        assert re.search(rf"^  (.* )?{option} ", out, flags=re.MULTILINE), option
    for title in ("Examples", "Options"):
        assert f"\n{title}\n" in out


def test_the_list_of_commands_has_a_line_for_each(width):
    out = answered("--help")
    for command in COMMANDS:
        assert re.search(rf"^  {command} +[A-Z][^\n]+\.$", out, re.MULTILINE), command
    panels = ("Experiments", "Looking after runs", "Single meshes", "Look up")
    assert [out.index(f"\n{panel}\n") for panel in panels] == sorted(out.index(f"\n{panel}\n") for panel in panels)


def test_alone_it_says_what_to_do_next_in_one_screen(width, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = answered()
    assert len(out.splitlines()) < 20
    assert max(map(len, out.splitlines())) <= width
    assert out.count("\n  meshfit ") == 7
    assert "meshfit --help" in out
    assert "meshfit status" not in out
    (tmp_path / "runs").mkdir()
    assert "meshfit status" in answered()


def test_examples_stand_below_each_other_with_their_comments_beside_or_above():
    text = "One.\n\nTwo\nlines.\n\nExamples:\n    a b\n\n    c  # said\n"
    assert Description.of(text) == Description(("One.", "Two lines."), ("a b", "c  # said"))
    assert Description.of("One.") == Description(("One.",), ())


def test_a_wrong_option_points_to_the_help_that_lists_them():
    assert "'meshfit run --help'" in refused("run", "quickstart", "--sett", "a=1")
