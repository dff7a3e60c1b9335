"""The first screen, `--help` of every command, and its examples."""

import ast
import re
import shlex
import subprocess
import sys

import pytest
import typer

from meshfit.cli import console, main
from tests.cli import answered, refused

GROUP = typer.main.get_command(main.app)
COMMANDS = dict(GROUP.commands)
PANELS = ("Experiments", "Run management", "Single meshes", "Reference")


def examples(text):
    return [line.strip() for line in text.partition("Example")[2].splitlines()[1:] if line.strip()]


def parsed(line):
    """The command lines within a line of shell, each parsed by its command."""
    words = shlex.split(line, comments=True)
    starts = [at for at, word in enumerate(words) if word == "meshfit"]
    found = []
    for start, end in zip(starts, [*starts[1:], len(words)], strict=True):
        own = words[start + 1 : end]
        own = own[: next((at for at, word in enumerate(own) if word in ("&&", ">", "|")), len(own))]
        found.append(own)
        if own != ["--help"] and own[1:] != ["--help"]:
            COMMANDS[own[0]].make_context(own[0], own[1:])
    return found


@pytest.fixture(params=[80, 120])
def width(request, monkeypatch):
    monkeypatch.setattr(console.out, "_width", request.param)
    monkeypatch.setattr("tests.cli.WIDTH", request.param)
    return request.param


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_are_command_lines_that_parse(command):
    assert command in [own[0] for line in examples(COMMANDS[command].help) for own in parsed(line)]


def test_the_first_examples_parse_too():
    assert len([own for line in examples(main.HELP) for own in parsed(line)]) > 2
    lines = [line for line in answered().splitlines() if line.startswith("  meshfit ")]
    assert ["run", "quickstart"] in [own for line in lines if "--install" not in line for own in parsed(line)]


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_fits_its_width_and_has_all_panels_options_and_examples(command, width):
    out = answered(*filter(None, [command]), "--help")
    assert max(map(len, out.splitlines())) <= width
    assert f" Usage: {' '.join(filter(None, ['meshfit', command]))} " in out
    params = COMMANDS[command].params if command else GROUP.params
    panels = {getattr(param, "rich_help_panel", None) or f"{param.param_type_name}s".title() for param in params}
    for panel in {*panels, "Options", *(() if command else PANELS)}:
        assert f"╭─ {panel} ─" in out
    for option in (name for param in params if param.param_type_name == "option" for name in param.opts):
        assert re.search(rf"^│ (.* )?{option} ", out, re.MULTILINE), option
    for line in examples(COMMANDS[command].help if command else main.HELP):
        assert " ".join(line.split()).replace("\\[", "[") in " ".join(out.split())


def test_the_short_option_prints_the_same():
    assert answered("-h") == answered("--help")
    assert answered("status", "-h") == answered("status", "--help")


def test_the_list_of_commands_has_a_line_for_each(width):
    out = answered("--help")
    for command in COMMANDS:
        assert re.search(rf"^│ {command} +[A-Z].+\. +│$", out, re.MULTILINE), command
    assert [out.index(f"─ {panel} ─") for panel in PANELS] == sorted(out.index(f"─ {panel} ─") for panel in PANELS)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_summary_of_a_command_is_the_first_line_of_its_help(command):
    assert COMMANDS[command].help.split("\n\n")[0] == COMMANDS[command].short_help


def test_text_in_brackets_is_not_taken_for_markup():
    assert "pip install 'meshfit[report]'" in " ".join(answered("render", "--help").split())


def test_alone_it_says_what_to_do_next_in_one_screen(width, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = answered()
    assert len(out.splitlines()) < 20
    assert max(map(len, out.splitlines())) <= width
    assert out.count("\n  meshfit ") == 8
    assert "meshfit --help" in out
    assert "meshfit status" not in out
    (tmp_path / "runs").mkdir()
    assert "meshfit status" in answered()


def test_a_wrong_option_points_to_the_help_that_lists_them():
    assert "'meshfit run --help'" in refused("run", "quickstart", "--sett", "a=1")


@pytest.mark.parametrize("argument", ["--help", "--version"])
def test_the_first_answers_import_no_command(argument):
    code = f"import sys; sys.argv = ['meshfit', {argument!r}]\nfrom meshfit.cli.main import run_app\nrun_app()\n"
    code += "print([name for name in sys.modules if name.startswith('meshfit.')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules = ast.literal_eval(done.stdout.splitlines()[-1])
    assert not {name.removeprefix("meshfit.cli.") for name in modules} & set(COMMANDS)


def test_no_help_waits_for_a_heavy_library():
    heavy = "{'torch', 'trimesh', 'pymeshlab', 'scipy', 'pykdtree', 'pyvista', 'igl', 'pyarrow', 'matplotlib'}"
    code = "import sys, typer; from meshfit.cli.main import app; group = typer.main.get_command(app)\n"
    code += "dict(group.commands)\n"
    code += f"print(sorted({heavy} & sys.modules.keys()))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "[]\n"
