"""Loading of configs with overrides, and errors with their lines."""

import pickle
from pathlib import Path

import pytest

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.loading import bundled_configs, config_path, load_experiment
from meshfit.config.strict_yaml import dump, parse_document
from meshfit.config.sweeps import variants_of
from meshfit.errors import ConfigError
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.solids import cube
from meshfit.mesh.targets import load_target
from meshfit.settings import build
from tests.loops import over


@pytest.fixture
def config(tmp_path):
    """Load a config of this text."""

    def load(text, *overrides):
        (tmp_path / "c.yaml").write_text(text, encoding="utf-8")
        return load_experiment(str(tmp_path / "c.yaml"), overrides).settings

    return load


def refusal(*arguments):
    with pytest.raises(ConfigError) as caught:
        load_experiment(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@over("name", bundled_configs())
def test_bundled_configs_load_by_name_and_by_path(name):
    experiment = load_experiment(name)
    assert experiment.name == name
    assert load_experiment(str(bundled_configs()[name])) == experiment


def test_table1_is_the_papers_comparison():
    settings = load_experiment("table1").settings
    assert settings.targets == ("bunny", "mousehead")
    assert settings.schemes == ("loop", "interp-loop")
    assert len(settings.seeds) >= 3
    assert settings.fit.losses.normal > 0


def test_a_bundled_name_comes_before_a_file_of_that_name_and_a_path_before_both(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("quickstart", "mine"):
        Path(name).write_text("seeds: [77]\n")
    assert config_path("quickstart") == bundled_configs()["quickstart"]
    assert load_experiment("./quickstart").settings.seeds == (77,)
    assert load_experiment("mine").settings.seeds == (77,)


def test_what_is_not_there_is_said(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert refusal("gone.yaml") == f"gone.yaml: no such file in {Path.cwd()}; `meshfit init gone.yaml` writes one"
    assert refusal("gone/quickstart") == "gone/quickstart: no such file: there is no folder gone"
    message = "'quikstart' is neither a config nor a file: did you mean 'quickstart'? allowed: quickstart"
    assert refusal("quikstart").startswith(message.removesuffix("allowed: quickstart"))
    assert refusal(str(tmp_path)) == f"{tmp_path}: expected a file, got a directory"


def test_a_file_that_is_no_text(tmp_path):
    (tmp_path / "a.yaml").write_bytes(b"seeds: [\xff]\n")
    assert refusal(str(tmp_path / "a.yaml")) == f"{tmp_path / 'a.yaml'}: not a text file in UTF-8"


def test_mesh_files_lie_relative_to_the_config(tmp_path, monkeypatch):
    folder = tmp_path / "project"
    (folder / "meshes").mkdir(parents=True)
    save_mesh(cube(), folder / "meshes" / "box.off")
    (folder / "c.yaml").write_text("targets: [bunny, meshes/box.off]\nsource: {mesh: meshes/../meshes/box.off}\n")
    monkeypatch.chdir(tmp_path)
    settings = load_experiment("project/c.yaml").settings
    assert settings.targets == ("bunny", str(folder / "meshes" / "box.off"))
    assert settings.source.mesh == str(folder / "meshes" / "box.off")


def test_links_keep_their_name_and_what_is_missing_is_looked_for_beside_the_config(tmp_path, monkeypatch):
    """A link may lead to a file without a suffix, as in stores that name files by their content."""
    folder = tmp_path / "project"
    folder.mkdir()
    save_mesh(cube(), folder / "store.off")
    (folder / "store.off").rename(folder / "ab12cd")
    (folder / "box.off").symlink_to("ab12cd")
    (folder / "dangling.ply").symlink_to("gone")
    (folder / "cow").mkdir()
    save_mesh(cube(), tmp_path / "here.ply")
    monkeypatch.chdir(tmp_path)
    for written, expected in {
        "box.off": str(folder / "box.off"),
        "dangling.ply": str(folder / "dangling.ply"),
        "gone.obj.gz": str(folder / "gone.obj.gz"),
        "../here.ply": str(tmp_path / "here.ply"),
        "here.ply": "here.ply",
        "cow": "cow",
        "~/a": "~/a",
    }.items():
        (folder / "c.yaml").write_text(f"targets: [{written}]\n")
        assert load_experiment("project/c.yaml").settings.targets == (expected,)
    assert load_target(str(folder / "box.off")).num_faces == 12


OVERRIDES = [
    (["fit.steps=7"], lambda s: s.fit.steps, 7),
    (["fit.losses.edge=0.5"], lambda s: (s.fit.losses.edge, s.fit.losses.chamfer), (0.5, 4)),
    (["fit.losses={edge: 0.5}"], lambda s: (s.fit.losses.edge, s.fit.losses.chamfer), (0.5, 4)),
    (["seeds=[1, 2]"], lambda s: s.seeds, (1, 2)),
    (["targets=[cow]"], lambda s: s.targets, ("cow",)),
    (["fit.steps=1", "fit.steps=2"], lambda s: s.fit.steps, 2),
    (["fit.steps=bad", "fit.steps=2"], lambda s: s.fit.steps, 2),
    (["fit.optimizer.schedule.name=cosine"], lambda s: s.fit.optimizer.schedule.name, "cosine"),
    (["fit.optimizer.lr=1e-3", "fit.optimizer.name=adam"], lambda s: (s.fit.optimizer.lr, s.fit.steps), (1e-3, 9)),
    (["source.radius=null", "source.centre=null"], lambda s: (s.source.radius, s.source.centre), (None, None)),
    (["source.decimate=40"], lambda s: s.source.decimate, 40),
    ([" fit.steps = 7 "], lambda s: s.fit.steps, 7),
    (["schemes=['interp-loop:alpha=0.5,weights=loop']"], lambda s: s.schemes, ("interp-loop:alpha=0.5",)),
]
TEXT = "seeds: [0]\nfit:\n  steps: 9\n  losses: {edge: 3, chamfer: 4}\n"


@over(("overrides", "value", "expected"), OVERRIDES)
def test_overrides(config, overrides, value, expected):
    assert value(config(TEXT, *overrides)) == expected


def test_both_spellings_of_centre_are_read_and_one_is_kept(config):
    text = "source: {center: [1, 2, 3], align: centre}\n"
    source = config(text).source
    assert (source.centre, source.align) == ((1, 2, 3), "center")
    assert config(text, "source.centre=null").source.centre is None
    assert config(text, "source.center=null").source.centre is None
    assert config("source: {centre: null}\n", "source={center: [0, 0, 1]}").source.centre == (0, 0, 1)
    with pytest.raises(ConfigError, match=r"source\.center: no such key: did you mean 'centre'"):
        config("source: {center: null, centre: null}\n")


LISTED = (
    "targets, target, define, schemes, seeds, normalise, weld, repair, write_frame, source, fit, measure, view, device"
)
BAD_OVERRIDES = {
    "fit.steps": "--set fit.steps: expected 'key=value', such as fit.steps=500",
    "=5": "--set =5: expected 'key=value'",
    "fit..steps=5": "--set fit..steps=5: expected 'key=value'",
    "fit.stps=5": "--set: fit.stps: no such key: did you mean 'steps'? allowed: method, steps",
    "stps=5": f"--set: stps: no such key: allowed: {LISTED}",
    "fit.steps=x": '--set: fit.steps: expected an integer, got "x"',
    "fit.steps=": "--set: fit.steps: expected an integer, got null",
    "fit.steps.a=3": '--set: fit.steps: expected an integer, got {"a": 3}',
    "fit=3": "--set: fit: expected a mapping of keys to values, got 3",
    "fit.losses=null": "--set: fit.losses: expected a mapping of keys to values, got null",
    "seeds=[1, x]": '--set: seeds[1]: expected an integer, got "x"',
    "seeds=[1, 1]": "--set: seeds: duplicate entry 1",
    "seeds=[": "--set seeds=[: line 1: not valid YAML: ",
    "fit.losses={edge: 1, edge: 2}": "--set fit.losses={edge: 1, edge: 2}, line 1: duplicate key 'edge'",
    "a\nb=1": "--set: a b: no such key",
    "a\nb": "--set a b: expected 'key=value'",
}


@over("text", BAD_OVERRIDES)
def test_overrides_at_fault_are_named(tmp_path, text):
    (tmp_path / "c.yaml").write_text(TEXT)
    assert refusal(str(tmp_path / "c.yaml"), [text]).startswith(BAD_OVERRIDES[text])


def test_faults_of_the_file_are_not_blamed_on_overrides(tmp_path):
    (tmp_path / "c.yaml").write_text(TEXT.replace("steps: 9", "steps: nine"))
    assert refusal(str(tmp_path / "c.yaml"), ["fit.samples=10"]) == (
        f'{tmp_path / "c.yaml"}, line 3: fit.steps: expected an integer, got "nine"'
    )


@over("name", bundled_configs())
def test_resolved_settings_are_written_and_read_back(name):
    settings = load_experiment(name, ["fit.trace_every=7", "source.centre=null"]).settings
    assert build(ExperimentSettings, parse_document(dump(settings.model_dump(mode="json")), "it").data) == settings


def test_values_are_shared_by_anchors_and_kept_under_keys_of_their_own(config):
    text = """\
x-losses: &losses {chamfer: 1, edge: 0.5}
x-note: anything
source: &source {levels: 2, mesh: octahedron}
fit: {steps: 7, losses: *losses}
sweep:
  variants:
    coarse: {source: *source}
    fine:
      source: {<<: *source, levels: 3}
"""
    settings = config(text)
    assert settings.fit.losses.edge == 0.5
    fine = variants_of(settings)[1].settings
    assert (fine.source.levels, fine.source.mesh) == (3, "octahedron")
    with pytest.raises(ConfigError, match=r"c\.yaml, line 1: fit\.losses\.egde: no such key"):
        config(text.replace("edge", "egde"))
    with pytest.raises(ConfigError, match=r"c\.yaml, line 3: source\.x-a: no such key"):
        config(text.replace("levels: 2", "x-a: 2"))


def test_paths_on_the_command_line_lie_relative_to_the_current_directory(tmp_path, monkeypatch):
    for folder in ("configs", "here"):
        (tmp_path / folder).mkdir()
        for name in ("scan.obj", "ball.ply", "edges.txt"):
            (tmp_path / folder / name).touch()
    (tmp_path / "configs/my.yaml").write_text("targets: [scan.obj]\n")
    monkeypatch.chdir(tmp_path / "here")
    changes = ["targets=[scan.obj, bunny, ../configs/ball.ply, gone.obj]", "source.mesh=ball.ply"]
    loaded = load_experiment("../configs/my.yaml", [*changes, "source.creases={file: edges.txt}"]).settings
    here, configs = tmp_path / "here", tmp_path / "configs"
    assert loaded.targets == (f"{here}/scan.obj", "bunny", f"{configs}/ball.ply", "gone.obj")
    assert (loaded.source.mesh, loaded.source.creases.file) == (f"{here}/ball.ply", f"{here}/edges.txt")
    swept = load_experiment("../configs/my.yaml", ["sweep={source.mesh: [ball.ply, scan.obj]}"]).settings
    assert swept.targets == (f"{configs}/scan.obj",)
    assert swept.sweep == {"source.mesh": [f"{here}/ball.ply", f"{here}/scan.obj"]}


def test_every_fault_is_reported_on_a_line_of_its_own(tmp_path, config):
    text = "seeds: [x]\nfit:\n  stepz: 3\n  losses: {edge: -1}\nschemes: [loop, lop]\nspeed: 1\n"
    with pytest.raises(ConfigError) as caught:
        config(text, "fit.samples=0")
    path, faults = tmp_path / "c.yaml", caught.value.faults
    assert str(caught.value) == "\n".join(faults)
    starts = {
        f'{path}, line 1: seeds[0]: expected an integer, got "x"',
        f"{path}, line 3: fit.stepz: no such key: did you mean 'steps'?",
        f"{path}, line 4: fit.losses.edge: expected a number of 0 or more, got -1",
        f"{path}, line 5: schemes[1]: 'lop' is not a scheme",
        f"{path}, line 6: speed: no such key",
        "--set: fit.samples: expected a number of",
    }
    assert len(faults) == len(starts)
    assert all(sum(fault.startswith(start) for fault in faults) == 1 for start in starts)
    with pytest.raises(ConfigError) as caught:
        config("".join(f"unknown{number}: 1\n" for number in range(30)))
    assert len(caught.value.faults) == 21
    assert caught.value.faults[-1] == "and 10 more faults"
    with pytest.raises(ConfigError) as caught:
        config("seeds: [0]\n", "fit.steps", "fit.steps=[", "seeds=[1]", "=3")
    assert [fault.partition(": ")[0] for fault in caught.value.faults] == [
        "--set fit.steps",
        "--set fit.steps=[",
        "--set =3",
    ]
    copied = pickle.loads(pickle.dumps(caught.value))
    assert copied.faults == caught.value.faults


def test_a_source_in_the_frame_of_the_target_keeps_place_and_size_or_is_refused(tmp_path):
    def loaded(source):
        (tmp_path / "c.yaml").write_text(f"source: {{frame: target, {source}}}\n", encoding="utf-8")
        return load_experiment(tmp_path / "c.yaml").settings.source

    source = loaded("mesh: bone")
    assert (source.radius, source.centre) == (None, None)
    for settings, fault in (
        ("mesh: bone, radius: 2", "keeps place and size; remove radius"),
        ("mesh: bone, centre: [0, 0, 1]", "keeps place and size; remove centre"),
        ("mesh: auto", "has no effect with mesh: auto"),
    ):
        with pytest.raises(ConfigError, match=fault):
            loaded(settings)
