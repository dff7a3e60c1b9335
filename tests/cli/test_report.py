"""`meshfit report` after real runs of all kinds: one self-contained file."""

import importlib
import re
import shutil
from pathlib import Path

import pytest

from tests.cli import invoke, refused
from tests.cli.processes import meshfit
from tests.small import config_file

pytest.importorskip("pyvista", reason="reports need the extra `report`")
pytestmark = pytest.mark.slow

BAD_LR = ("--set", "seeds=[0]", "--set", "schemes=[loop]", "--set", "fit.optimizer.lr=1e30", "--name", "small")


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A folder in which the small experiment was run, one trial that failed, and a sweep of one seed."""
    folder = tmp_path_factory.mktemp("ran")
    meshfit("run", config_file(folder), "-q", folder=folder)
    meshfit("run", "small.yaml", "-q", *BAD_LR, folder=folder, code=1)
    text = (folder / "small.yaml").read_text().replace("[0, 1]", "[0]") + "sweep: {fit.losses.edge: [0.1, 2.0]}\n"
    (folder / "sweep.yaml").write_text(text)
    meshfit("run", "sweep.yaml", "-q", folder=folder)
    return folder


@pytest.fixture
def copied(ran, tmp_path, monkeypatch):
    shutil.copytree(ran, tmp_path, dirs_exist_ok=True)
    for path in tmp_path.glob("runs/*/*/*/*/result.json"):
        path.write_text(path.read_text().replace(str(ran), str(tmp_path)))  # where the copy's target is
    monkeypatch.chdir(tmp_path)
    return tmp_path


def page_of(*runs, options=(), output="page", page="page/index.html"):
    """The text of the page, its one file having been told of."""
    done = invoke("report", *runs, "-o", output, "--partial", *options)
    assert done.code == 0, done.err
    assert re.fullmatch(rf"wrote {re.escape(page)}: [\d.]+ [kM]B\n", done.out)
    return done, Path(page).read_text(encoding="utf-8")


def text_of(page):
    """What a reader sees of it: no scripts, no pictures."""
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", re.sub(r"<(script|style)\b.*?</\1>", "", page, flags=re.DOTALL)))


def test_a_page_has_every_section_and_nothing_that_is_loaded(copied):
    done, page = page_of("runs/small")
    assert re.search(r"drawing: \d+ of \d+\n", done.err)
    assert [path.name for path in (copied / "page").iterdir()] == ["index.html"]
    sections = re.findall(r'<section id="(\w+)">', page)
    assert sections == [
        "results",
        "pictures",
        "scenes",
        "curves",
        "histograms",
        "settings",
        "trials",
        "failures",
        "machines",
    ]
    for source in re.findall(r'\b(?:src|href)="([^"]*)"', page):
        assert source.startswith(("data:image/webp;base64,", "#"))
    assert page.count("<img") == page.count('alt="') > 6
    text = text_of(page)
    assert "the fit diverged at step" in text
    assert "interp-loop" in text
    assert "<small>[" in page
    assert len(page) < 1.2e6


def test_what_users_name_is_not_taken_for_markup(copied):
    (copied / "ellipsoid.ply").rename(copied / "<i>&x.ply")
    config = (copied / "small.yaml").read_text().replace("ellipsoid.ply", "'<i>&x.ply'").replace("[0, 1]", "[0]")
    (copied / "odd.yaml").write_text(config)
    meshfit("run", "odd.yaml", "-q", "--set", "schemes=[loop]", "--name", "odd", folder=copied)
    _, page = page_of("runs/odd", output="one/odd.html", page="one/odd.html")
    assert "<i>" not in page
    assert "&lt;i&gt;&amp;x" in page


def test_a_target_that_is_gone_or_has_changed_is_told_and_the_rest_is_kept(copied):
    _, whole = page_of("runs/small")
    (copied / "ellipsoid.ply").write_text("ply\n")
    _, page = page_of("runs/small")
    assert re.sub(r"\d\d:\d\d", "", text_of(page)) == re.sub(r"\d\d:\d\d", "", text_of(whole))
    shutil.rmtree(copied / "runs/targets")
    _, page = page_of("runs/small")
    assert "has changed since" in text_of(page)
    (copied / "ellipsoid.ply").unlink()
    for path in copied.glob("runs/small/*/interp-loop/seed-[01]-*/result.ply"):
        path.write_bytes(path.read_bytes()[:-1] + b"x")  # of another size, the trial would be damaged
    _, page = page_of("runs/small")
    text = text_of(page)
    assert "The target is not shown" in text
    assert re.search(r"interp-loop, seed \d, is not shown", text)
    assert page.count("<img") == 2
    assert "ramp" not in page.partition("</style>")[2].partition("<script>")[0]


def test_a_sweep_of_one_seed_beside_another_experiment(copied):
    _, page = page_of(
        "runs", options=("--metric", "distance.mean", "--metric", "f_score.f1", "--baseline", "interp-loop")
    )
    text = text_of(page)
    assert "edge=0.1" in text
    assert "edge=2.0" in text
    assert "fit.losses.edge" in text.partition("That differ between trials")[2]
    assert "mean distance" in text
    assert page.count("data-scene=") == 2


def test_results_on_images_are_shown_in_their_views_without_the_photographs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    meshfit("views", "bone", "-o", "photos", "--count", "5", "--size", "32", folder=tmp_path)
    Path("views.yaml").write_text(
        "targets: [{images: photos, hold_out: 2, truth: bone}]\nschemes: [loop]\nfit: {steps: 3, samples: 100}\n"
        "source: {mesh: octahedron, levels: 2}\nmeasure: {samples: 500, points: 500}\n"
    )
    meshfit("run", "views.yaml", "-q", folder=tmp_path)
    _, whole = page_of("runs")
    shutil.rmtree("photos")
    _, page = page_of("runs")
    assert re.findall("<img[^>]*>", page) == re.findall("<img[^>]*>", whole)
    assert page.count("on the mask of") == 5
    text = text_of(page)
    assert len(re.findall(r"view-0\d(?:, held out)? IoU 0\.\d{3} ", text)) == 5
    assert "true mesh" in text
    assert "outline of the result; filled where it is outside the mask" in text


def test_where_all_have_failed_the_page_says_why(copied):
    for folder in copied.glob("runs/small/*/*/seed-*"):
        if (folder / "result.json").exists():
            shutil.rmtree(folder)
    (copied / "runs/small/plan.json").unlink()
    _, page = page_of("runs/small")
    assert re.findall(r'<section id="(\w+)">', page) == ["results", "failures"]
    assert "No trial is complete" in text_of(page)
    assert "the fit diverged at step" in text_of(page)


def test_what_cannot_be_reported_is_refused(copied):
    assert "no such run directory" in refused("report", "nowhere", "-o", "page", "-q")
    assert "is not a metric" in refused("report", "runs", "-o", "page", "-q", "--metric", "nothing")
    assert "has no results" in refused("report", "runs", "-o", "page", "-q", "--baseline", "butterfly")
    assert not (copied / "page").exists()


@pytest.mark.parametrize("missing", ["matplotlib", "jinja2", "pyvista"])
def test_without_a_library_the_extra_is_named(monkeypatch, missing):
    real = importlib.import_module

    def only_others(name, *rest):
        if name.startswith(missing):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(importlib, "import_module", only_others)
    message = refused("report", "runs", "-o", "page")
    assert missing in message
    assert "pip install 'meshfit[report]'" in message
