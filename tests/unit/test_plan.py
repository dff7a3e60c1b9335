import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshfit.config.loading import Experiment
from meshfit.config.path_parts import folder_key, path_part
from meshfit.errors import ConfigError, MeshError, MeshfitWarning, StoreError
from meshfit.experiment.plan import plan
from meshfit.experiment.storage.folder_checks import check_folders
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.target_labels import distinct_labels
from meshfit.settings import override
from tests.small import ellipsoid, experiment


def only(folder: Path, **changes: object):
    (trial,) = plan([experiment(folder, **changes)])
    return trial


def test_a_plan_is_the_product_of_targets_schemes_and_seeds(tmp_path):
    trials = plan([experiment(tmp_path, schemes=["loop", "midpoint"], seeds=[3, 1, 2])])
    assert [(trial.scheme, trial.seed) for trial in trials] == [
        (scheme, seed) for scheme in ("loop", "midpoint") for seed in (3, 1, 2)
    ]
    assert len({trial.identity for trial in trials}) == len({trial.folder for trial in trials}) == 6


def test_a_trial_listed_twice_is_planned_once(tmp_path):
    one = experiment(tmp_path, seeds=[0, 1])
    assert len(plan([one, experiment(tmp_path, seeds=[1, 2])])) == 3


@pytest.mark.parametrize(
    "change",
    [
        {"seeds": [1]},
        {"schemes": ["midpoint"]},
        {"schemes": ["interp-loop:alpha=0.5"]},
        {"fit": {"steps": 21}},
        {"fit": {"losses": {"edge": 0.5}}},
        {"normalise": "box"},
        {"dtype": "float64"},
        {"measure": {"samples": 501}},
        {"source": {"levels": 1}},
    ],
)
def test_any_setting_changes_the_identity(tmp_path, change):
    assert only(tmp_path, **change).identity != only(tmp_path).identity


def test_the_content_of_the_target_enters_the_identity_and_its_place_does_not(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    here, there = only(tmp_path), only(tmp_path / "elsewhere")
    assert here.settings.targets != there.settings.targets
    assert here.identity == there.identity
    other = ellipsoid(tmp_path, "other.off")
    renamed = other.rename(tmp_path / "elsewhere" / "ellipsoid.off")
    assert only(tmp_path, targets=[str(renamed)]).identity != here.identity


def test_bad_input_is_refused_before_anything_runs(tmp_path):
    with pytest.raises(MeshError, match="no such file"):
        plan([experiment(tmp_path, targets=["missing.obj"])])
    broken = tmp_path / "broken.off"
    broken.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n")
    with pytest.raises(MeshError, match="vertex 2 has a coordinate that is not finite"):
        plan([experiment(tmp_path, source={"mesh": str(broken)})])


def test_folders_have_no_characters_that_file_systems_refuse(tmp_path):
    folder = only(tmp_path, schemes=["interp-loop:alpha=0.5,valence3=zorin"]).folder
    assert not set(':=,<>"|?*') & set(str(folder))


def test_no_name_leads_out_of_the_run_directory_or_looks_like_the_folder_of_a_trial(tmp_path):
    good = ellipsoid(tmp_path)
    for stem, words in (
        ("..", r"target .*: its name '\.\.' is no name of a folder; rename the file"),
        (".", "is no name of a folder"),
        ("a\\b", "has a separator of paths"),
        ("a\x1bb", "has control or invisible characters"),
        ("Nul", "is reserved on Windows"),
        ("COM1.old", "is reserved on Windows"),
        ("seed-3-0123456789", "has the form seed-N-HASH, which is that of the folders of trials"),
        ("é" * 130, "has 260 bytes, more than the 255 of a file's name"),
    ):
        if len(stem) < 100:
            copied = tmp_path / f"{stem}.ply"
            copied.write_bytes(good.read_bytes())
            with pytest.raises(ConfigError, match=words):
                plan([experiment(tmp_path, targets=[str(good), str(copied)])])
        with pytest.raises(ConfigError, match=r"^experiment .*; rename its config, or give --name"):
            plan([replace(experiment(tmp_path), name=stem)])


@given(st.text(alphabet=st.sampled_from("./\\\x00\x1b\ud800seed-0123456789abcdef ~é")))
def test_a_part_of_a_path_is_the_name_of_one_folder(name):
    with suppress(ConfigError):
        inside = Path("runs", path_part(name, "name"))
        assert inside.name == name
        assert Path(os.path.normpath(inside)).parent == Path("runs")


def test_targets_of_one_file_name_get_longer_labels():
    names = ["sn/1a/models/normalized.obj", "sn/2b/models/normalized.obj", "x.obj", "x.ply", "bunny.ply", "bunny"]
    assert distinct_labels(names) == {
        "sn/1a/models/normalized.obj": "1a-normalized",
        "sn/2b/models/normalized.obj": "2b-normalized",
        "x.obj": "x.obj",
        "x.ply": "x.ply",
        "bunny.ply": "bunny.ply",
    }
    deep = distinct_labels(["a/p/m.obj", "a/q/m.obj", "b/p/m.obj"])
    assert len(set(deep.values())) == 3
    assert distinct_labels(["a/m.obj", "b/n.obj", "bunny"]) == {}
    views = ["views:of=a/m.obj,count=4", "views:of=b/m.obj,count=4"]
    assert list(distinct_labels(views).values()) == ["a-m-4-views", "b-m-4-views"]


COMPOSED, DECOMPOSED = "caf\u00e9", "cafe\u0301"


def test_targets_that_share_a_folder_on_some_systems_get_longer_labels_or_are_refused(tmp_path):
    """macOS and Windows do not tell case or the form of accents apart, and Windows drops dots at the end."""
    assert distinct_labels(["a/Cow.obj", "b/cow.obj", "Bunny.ply", "bunny"]) == {
        "a/Cow.obj": "a-Cow",
        "b/cow.obj": "b-cow",
        "Bunny.ply": "Bunny.ply",
    }
    for first, second in (("Cow", "cow"), (COMPOSED, DECOMPOSED), ("a..", "a"), ("straße", "STRASSE")):
        assert folder_key(first) == folder_key(second)
        names = [str(ellipsoid(tmp_path, f"{name}.ply")) for name in (first, second)]
        if first != "a..":  # with its suffix, it is another name
            with pytest.raises(ConfigError, match=r"^targets '.*' and '.*': their folders .* are the same on macOS"):
                plan([experiment(tmp_path, targets=names)])
        with pytest.raises(ConfigError, match=r"^experiments '.*' and '.*': their folders .*, or give --name$"):
            plan([replace(experiment(tmp_path), name=name) for name in (first, second)])
    assert len({folder_key(name) for name in ("cow", "cows", "c\u00f4w", ".cow")}) == 4


def test_names_of_the_run_directory_itself_are_no_names_of_experiments_and_targets(tmp_path):
    for name in ("targets", "Targets"):
        with pytest.raises(ConfigError, match=r"^experiment '.*' is a name that the run directory uses itself; rename"):
            plan([replace(experiment(tmp_path), name=name)])
    for name in ("plan.json", "search-0a1b.json"):
        with pytest.raises(ConfigError, match=rf"its name '{name}' is a name that the run directory uses itself"):
            plan([experiment(tmp_path, targets=[str(ellipsoid(tmp_path, f"{name}.ply"))])])


def test_folders_of_trials_lie_in_the_run_directory_and_are_their_own(tmp_path):
    (trial,) = plan([experiment(tmp_path)])
    store = RunDirectory(tmp_path / "runs")
    check_folders([trial], store)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "runs").symlink_to(tmp_path / "elsewhere")  # a run directory may be a link
    check_folders([trial], store)
    with pytest.raises(StoreError, match="outside the run directory"):
        check_folders([replace(trial, experiment="../small")], store)
    (tmp_path / "other").mkdir()
    (tmp_path / "runs/small").symlink_to(tmp_path / "other")
    with pytest.raises(StoreError, match=r"outside the run directory, in .*other/ellipsoid/loop; remove the link"):
        check_folders([trial], store)
    (tmp_path / "runs/small").unlink()
    (tmp_path / "runs/Small").mkdir()
    with pytest.raises(StoreError, match=r"runs/Small and .*runs/small: .*; give another name, or another run dir"):
        check_folders([trial], store)
    (tmp_path / "runs/small").mkdir()  # of an earlier version
    check_folders([trial], store)


def test_names_of_files_do_not_change_what_a_trial_is(tmp_path):
    first, *_ = plan([experiment(tmp_path)])
    other = str(ellipsoid(tmp_path, "other.ply"))
    second, *_ = plan([Experiment("small", override(experiment(tmp_path).settings, {"targets": [other]}))])
    assert first.identity == second.identity
    assert first.target_label != second.target_label


def test_points_of_a_sweep_that_make_one_trial_are_named(tmp_path):
    swept = {"sweep": {"source.levels": [1, 2, 3], "source.wanted_verts": [60]}}
    named = "'levels=1, wanted_verts=60', .* are the same trials; they run once"
    with pytest.warns(MeshfitWarning, match=named):
        trials = plan([experiment(tmp_path, **swept)])
    assert len(trials) == len({trial.identity for trial in trials})
    with pytest.raises(ConfigError, match="'a ' has blanks at an end; name it 'a'"):
        plan([experiment(tmp_path, sweep={"variants": {"a": {}, "a ": {"fit": {"steps": 3}}}})])
