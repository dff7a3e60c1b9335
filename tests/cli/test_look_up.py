"""Commands that answer at once: version, schemes, targets, schema, init; and usage errors."""

import json
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.loading import load_experiment
from meshfit.mesh.targets import NAMED_TARGETS
from meshfit.subdivision.registry import SCHEMES
from tests.cli import answered, refused
from tests.loops import over


def test_version():
    assert answered("--version") == f"meshfit {version('meshfit')}\n"


def test_schemes_lists_all():
    out = answered("schemes")
    for name, entry in SCHEMES.items():
        assert re.search(rf"^{name} +{entry.kind}", out, re.MULTILINE), name
    domains = list(dict.fromkeys(entry.domain for entry in SCHEMES.values()))
    assert re.findall(r"^on (\w+)", out, re.MULTILINE) == domains


def test_schemes_as_json():
    rows = json.loads(answered("schemes", "--json"))
    assert [row["name"] for row in rows] == list(SCHEMES)
    for row in rows:
        entry = SCHEMES[row["name"]]
        assert (row["title"], row["kind"], row["continuity"]) == (entry.title, entry.kind, entry.continuity)
        assert row["domain"] == entry.domain
        assert {key: parameter["default"] for key, parameter in row["parameters"].items()} == {
            key: parameter.default for key, parameter in entry.parameters.items()
        }


@pytest.mark.parametrize("name", SCHEMES)
def test_one_scheme_with_its_masks(name):
    out = answered("schemes", name)
    assert out.startswith(f"{name}  {SCHEMES[name].title}, {SCHEMES[name].kind}\n")
    row = json.loads(answered("schemes", name, "--json"))
    assert row["masks"]
    for mask in row["masks"]:
        assert mask["where"] in out


def test_masks_are_those_of_the_parameters_given():
    assert "3/8 each end (2), 1/8 each opposite (2)" in answered("schemes", "loop")
    half, whole = (answered("schemes", f"interp-loop:alpha={alpha}") for alpha in ("0.5", "1"))
    assert half.startswith("interp-loop:alpha=0.5  ")
    assert whole.startswith("interp-loop  ")
    assert half != whole


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("catmull-clark", "3/8 each end (2), 1/16 each beside an end (4)"),
        ("catmull-clark", "9/16 itself, 3/32 each neighbour (4), 1/64 each diagonally across (4)"),
        ("kobbelt", "81/256 each corner (4), -9/256 each across an edge (8), 1/256"),
        ("interp-sqrt2", "5/16 each corner (4), -1/32 each across an edge (8)"),
        ("doo-sabin", "9/16 near corner, 3/16 each corner beside it (2), 1/16 far corner"),
        ("interp-sqrt2", "-1/16, 9/16, 9/16, -1/16 at -1 … 2 along it"),
        ("ternary", "1/27, 16/27, 10/27 at -1 … 1 along it"),
    ],
)
def test_masks_on_polygons(name, message):
    assert message in " ".join(answered("schemes", name).split())


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("lop", "error: 'lop' is not a scheme: did you mean 'loop'? allowed: midpoint, loop, "),
        ("xyz", "error: 'xyz' is not a scheme: allowed: midpoint, loop, "),
        ("loop:weight=loop", "error: scheme 'loop' has no parameter 'weight': did you mean 'weights'?"),
        ("interp-loop:alpha=2", "error: interp-loop: alpha=2 is not allowed: expected a number from 0 to 1"),
        ("interp-loop:alpha", "error: scheme 'interp-loop:alpha': expected 'key=value', got 'alpha'"),
    ],
)
@pytest.mark.parametrize("option", [(), ("--json",)])
def test_schemes_that_do_not_exist(name, message, option):
    assert refused("schemes", name, *option).startswith(message)


def test_targets_lists_all_with_their_counts():
    out = answered("targets")
    rows = json.loads(answered("targets", "--json"))
    assert [row["name"] for row in rows] == list(NAMED_TARGETS)
    for row in rows:
        assert re.search(rf"^{row['name']} +{row['verts']:,} +{row['faces']:,} ", out, re.MULTILINE)
        assert row["sha256"] == NAMED_TARGETS[row["name"]].sha256
    assert {row["name"]: row["faces"] for row in rows}["bunny"] == 56172


def test_schema_is_that_of_the_settings():
    assert json.loads(answered("schema")) == json.loads(json.dumps(ExperimentSettings.model_json_schema()))


def test_init_writes_a_config_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert answered("init") == "wrote experiment.yaml; now: meshfit run experiment.yaml\n"
    assert load_experiment("experiment.yaml").settings == ExperimentSettings()
    (tmp_path / "experiment.yaml").write_text("mine")
    message = "error: experiment.yaml: already exists; choose another name, or overwrite it with --force"
    assert refused("init") == message
    assert (tmp_path / "experiment.yaml").read_text() == "mine"
    answered("init", "--force")
    assert load_experiment("experiment.yaml").settings == ExperimentSettings()


def test_init_where_nothing_can_be_written(tmp_path):
    path = tmp_path / "gone" / "a.yaml"
    assert (
        refused("init", path)
        == f"error: {path}: cannot be written: there is no folder {path.parent}; create it, or choose another place"
    )


@over(
    ("name", "finding"),
    [
        ("scan.obj", "'.obj' is not that of a config; allowed: .yaml, .yml; did you mean scan.yaml?"),
        ("mine", "no suffix is not that of a config; allowed: .yaml, .yml; did you mean mine.yaml?"),
        (".yaml", "no suffix is not that of a config; allowed: .yaml, .yml; did you mean .yaml.yaml?"),
        ("a.yaml.gz", "'.gz' is not that of a config; allowed: .yaml, .yml; did you mean a.yaml.yaml?"),
    ],
)
def test_init_writes_configs_only(tmp_path, monkeypatch, name, finding):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("v 0 0 0")
    assert refused("init", name, "--force") == f"error: {name}: {finding}"
    assert (tmp_path / name).read_text() == "v 0 0 0"


@over("name", ["a b.yaml", "it's $HOME `date` \\ !x.yml", "=ls.yaml", "#1 [x]*?.yaml", "~x;(y)&|<z>.yaml", "ü.YAML"])
def test_hints_can_be_pasted_into_a_shell(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    hint = (
        refused("run", f"./{name}").partition("`meshfit init ")[2].partition("` writes one")[0]
        if "`" not in name
        else ""
    )
    written = answered("init", name).rpartition("now: meshfit run ")[2].rstrip("\n")
    for word in filter(None, (hint, written)):
        pasted = subprocess.run(["bash", "-c", f"printf '%s' {word}"], capture_output=True, text=True, check=True)
        assert Path(pasted.stdout) == Path(name)
        assert not word.startswith(("=", "-"))


USAGE = {
    ("--bad",): "error: No such option: --bad. See 'meshfit --help'.",
    ("bad",): "error: No such command 'bad'. See 'meshfit --help'.",
    ("scheme",): "error: No such command 'scheme'. Did you mean",
    ("schemes", "--bad"): "error: No such option: --bad. See 'meshfit schemes --help'.",
    ("schemes", "a", "b"): "error: Got unexpected extra argument",
    ("schema", "a"): "error: Got unexpected extra argument",
    ("subdivide", "cow"): "error: Missing argument 'OUT'. See 'meshfit subdivide --help'.",
    ("measure", "cow", "cow", "--samples", "many"): "error: Invalid value for '--samples': ",
    ("measure", "cow", "cow", "--normalise", "Box"): "error: Invalid value for '--normalise': ",
}


@pytest.mark.parametrize("arguments", USAGE, ids=" ".join)
def test_wrong_usage_is_answered_in_one_line_that_points_to_help(arguments):
    message = refused(*arguments)
    assert message.startswith(USAGE[arguments])
    assert message.endswith("--help'.")


@pytest.mark.parametrize(
    ("module", "libraries"),
    [
        ("meshfit.cli.main", {"torch", "trimesh", "pymeshlab", "scipy", "pykdtree", "pyvista", "igl"}),
        ("meshfit.experiment.running.scheduler", {"torch", "trimesh", "pymeshlab", "igl"}),  # workers load them
    ],
)
def test_importing_loads_no_heavy_library(module, libraries):
    code = f"import sys, meshfit, {module}; print(sorted({libraries} & sys.modules.keys()))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "[]\n"
