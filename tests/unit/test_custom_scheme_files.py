"""Files that define a scheme: accepted in place of a scheme's name, and refused with the place of the error."""

from pathlib import Path

import pytest

from meshfit.config.loading import load_experiment
from meshfit.config.scheme_files import resolve_specs, scheme_name_for
from meshfit.config.strict_yaml import dump
from meshfit.errors import ConfigError

LOOP = "edge: {end: 3/8, opposite: 1/8}\nvertex: 3/8\nboundary: cubic-bspline\n"


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A folder below the working one, with a config that names files of schemes."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "project" / "own").mkdir(parents=True)
    write("project/own/my-loop.yaml", LOOP)
    write("project/own/softer.yaml", "base: my-loop.yaml\nalpha: 0.5\n")
    return Path("project")


def write(path, text):
    Path(path).write_text(text, encoding="utf-8")


def load(text, *overrides):
    write("project/c.yaml", text)
    return load_experiment("project/c.yaml", overrides).settings


def refusal(text, *overrides):
    with pytest.raises(ConfigError) as caught:
        load(text, *overrides)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_file_becomes_a_definition_under_its_stem(project):
    settings = load("schemes: [loop, own/my-loop.yaml, 'own/softer.yaml:alpha=0.25', own/softer.yaml]\n")
    assert settings.schemes == ("loop", "my-loop", "softer:alpha=0.25", "softer")
    assert list(settings.define) == ["my-loop", "softer"]
    assert settings.define["softer"].base == "my-loop"


def test_what_is_resolved_can_be_loaded_anywhere(project, tmp_path):
    settings = load("schemes: [own/softer.yaml]\n")
    (tmp_path / "elsewhere").mkdir()
    write(tmp_path / "elsewhere" / "resolved.yaml", dump(settings.model_dump(mode="json")))
    assert load_experiment("elsewhere/resolved.yaml").settings == settings


def test_the_base_of_a_definition_may_be_a_file(project):
    settings = load("define: {mine: {base: own/my-loop.yaml}}\nschemes: [mine]\n")
    assert settings.define["mine"].base == "my-loop"
    assert "my-loop" in settings.define


def test_paths_in_overrides_are_those_of_the_shell(project):
    write("quick.yml", LOOP)
    assert load("seeds: [0]\n", "schemes=[loop, quick.yml]").schemes == ("loop", "quick")
    assert "schemes[0]: own/my-loop.yaml: no such file" in refusal("seeds: [0]\n", "schemes=[own/my-loop.yaml]")


def test_a_name_may_stand_for_one_definition_only(project):
    same = "define: {my-loop: {edge: {opposite: 1/8, end: 3/8}, vertex: 3/8, boundary: cubic-bspline}}\n"
    assert load(f"{same}schemes: [own/my-loop.yaml]\n").schemes == ("my-loop",)
    other = "define: {my-loop: {base: loop}}\n"
    assert refusal(f"{other}schemes: [own/my-loop.yaml]\n") == (
        "project/c.yaml, line 2: schemes[0]: project/own/my-loop.yaml: 'define' has another 'my-loop'; rename one"
    )
    write("project/my-loop.yaml", "base: loop\n")
    assert "project/own/my-loop.yaml defines 'my-loop' too; rename one" in refusal(
        "schemes: [own/my-loop.yaml, my-loop.yaml]\n"
    )
    assert load("schemes: [own/my-loop.yaml, 'own/../own/softer.yaml']\n").schemes == ("my-loop", "softer")


FAULTS = {
    "": "bad.yaml: the file is empty",
    "- 1\n": "bad.yaml: expected a mapping of settings",
    "base: [\n": "bad.yaml: line 2: not valid YAML",
    "base: loop\nbase: sqrt3\n": "bad.yaml, line 2: duplicate key 'base'",
    "# a scheme\nbase: lop\n": "bad.yaml, line 2: define.bad.base: 'lop' is not a scheme: did you mean 'loop'?",
    "base: bad.yaml\n": "bad.yaml, line 1: define.bad.base: 'bad' is the definition itself",
    "base: gone.yaml\n": "gone.yaml: no such file",
    "base: softer.yaml\n": "bad.yaml, line 1: define.bad.base: 'softer' is a push-back too",
    f"{LOOP}edgy: 1\n": "bad.yaml, line 4: define.bad.edgy: no such key: did you mean 'edge'?",
    LOOP.replace("1/8}", "cos}"): "bad.yaml, line 1: define.bad.edge.opposite: 'cos', character 1: 'cos' is a function",
    "targets: [bunny]\n": "bad.yaml, line 1: define.bad.targets: no such key",
}


@pytest.mark.parametrize("text", FAULTS)
def test_faults_are_said_with_the_files_own_lines(project, text):
    write("project/own/bad.yaml", text)
    message = refusal("seeds: [0]\nschemes: [loop, own/bad.yaml]\n")
    assert FAULTS[text] in message
    assert "project/own" in message


def test_files_that_refer_to_each_other_come_to_an_end(project):
    write("project/a.yaml", "base: b.yaml\n")
    write("project/b.yaml", "base: a.yaml\n")
    assert "is a push-back too" in refusal("schemes: [a.yaml]\n")


@pytest.mark.parametrize("name", ["My-Loop.yaml", "my_loop.yaml", "loop.yaml", ".yaml"])
def test_the_name_of_a_file_must_be_one_for_a_scheme(project, name):
    write(project / name, LOOP)
    assert "name" in refusal(f"schemes: [{name}]\n") or "no such file" in refusal(f"schemes: [{name}]\n")


def test_files_that_cannot_be_read(project):
    (project / "latin.yaml").write_bytes(b"base: \xff\n")
    assert refusal("schemes: [latin.yaml]\n") == "project/latin.yaml: not a text file in UTF-8"
    assert refusal("schemes: [own/my-lop.yaml]\n") == (
        "project/c.yaml, line 1: schemes[0]: project/own/my-lop.yaml: no such file; did you mean "
        "'project/own/my-loop.yaml'?"
    )
    (project / "folder.yaml").mkdir()
    assert "schemes[0]: project/folder.yaml: expected a file, got a directory" in refusal("schemes: [folder.yaml]\n")


def test_what_is_no_list_of_specs_is_left_to_the_checks(project):
    assert refusal("schemes: own/my-loop.yaml\n").startswith("project/c.yaml, line 1: schemes: expected ")
    assert refusal("schemes: [[own/my-loop.yaml]]\n").startswith("project/c.yaml, line 1: schemes[0]: expected ")
    assert refusal("define: null\nschemes: [loop]\n").startswith("project/c.yaml, line 1: define: expected ")
    assert refusal("define: {mine: {base: null}}\n").startswith("project/c.yaml, line 1: define.mine.base: expected")


def test_specs_from_a_command_line(project):
    own = load("schemes: [own/softer.yaml]\n").define
    for spec in ("softer:alpha=0.5", "project/own/softer.yaml:alpha=0.5"):
        assert resolve_specs([spec], own) == (["softer:alpha=0.5"], own)
    specs, define = resolve_specs(["softer:alpha=0.5", "project/own/my-loop.yaml"], own)
    assert specs == ["softer:alpha=0.5", "my-loop"]
    assert define == own
    write("softer.yaml", "base: sqrt3\n")
    with pytest.raises(ConfigError, match=r"^softer\.yaml: 'define' has another 'softer'; rename one$"):
        resolve_specs(["softer.yaml"], own)


def test_the_name_of_a_scheme_in_a_file():
    assert scheme_name_for("a b/my-loop.yaml") == "my-loop"
    assert scheme_name_for("a:b/softer.yml:alpha=0.5") == "softer:alpha=0.5"
    assert scheme_name_for("interp-loop:alpha=0.5") == "interp-loop:alpha=0.5"
