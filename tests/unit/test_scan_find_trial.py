import pytest

from meshfit.errors import ConfigError, StoreError
from meshfit.experiment.status import scan as module
from meshfit.experiment.status.scan import find_trial
from tests.runs import NOW, begun, complete, place, write_plan


def found(text, runs):
    return find_trial(str(text), runs, NOW)[1].path


def refusal(text, runs):
    with pytest.raises(ConfigError) as caught:
        find_trial(str(text), runs, NOW)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def digits(folder):
    return folder.name.rpartition("-")[2]


def test_a_trial_is_meant_by_its_folder_a_file_in_it_or_its_first_digits(tmp_path):
    folder, other = complete(tmp_path, seed=0), begun(tmp_path, seed=1)
    elsewhere = tmp_path / "elsewhere"
    assert found(folder, elsewhere) == found(folder / "result.json", elsewhere) == folder
    assert found(digits(folder), tmp_path) == found(digits(folder)[:4].upper(), tmp_path) == folder
    assert found(digits(other) + "0" * 54, tmp_path) == other


def test_a_trial_that_is_only_planned_is_meant_by_its_folder_or_digits_too(tmp_path):
    write_plan(tmp_path / "small", [{"seed": 4}])
    folder = tmp_path / place(seed=4)
    assert found(digits(folder), tmp_path) == found(folder, tmp_path) == folder


def test_digits_that_several_begin_with_are_refused_with_those(tmp_path, monkeypatch):
    folder = complete(tmp_path, seed=0)
    other = tmp_path / "other/bunny/loop" / folder.name
    other.parent.mkdir(parents=True)
    folder.rename(other)
    folder.mkdir()
    (folder / "result.json").write_text("{}")
    message = refusal(digits(folder)[:6], tmp_path)
    assert message.startswith(
        f"2 trials under {tmp_path} begin with {digits(folder)[:6]}: {digits(folder)} (other, bunny"
    )
    assert "(small, bunny · loop · seed 0)" in message


@pytest.mark.parametrize("text", ["abc", "12", "zzzz", "gone/seed-0-0123456789", "ffffffffff", ""])
def test_what_is_no_trial_is_refused_with_those_that_there_are(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    for seed in range(module._MOST_LISTED + 2):
        complete(tmp_path / "runs", seed=seed)
    message = refusal(text or "-", tmp_path / "runs")
    assert "4 or more digits of its identity; the trials are: " in message
    assert message.count("bunny · loop · seed") == module._MOST_LISTED
    assert message.endswith(" and 2 more")


def test_a_folder_above_trials_names_one_only_if_it_holds_one(tmp_path):
    folder = complete(tmp_path)
    assert find_trial(str(folder.parent), tmp_path, NOW)[1].path == folder
    complete(tmp_path, seed=1)
    assert "expected the folder of one trial; the trials below it are: " in refusal(folder.parent, tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(StoreError, match="no trial under"):
        find_trial(str(tmp_path / "empty"), tmp_path, NOW)
