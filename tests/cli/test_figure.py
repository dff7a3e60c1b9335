import re
from types import SimpleNamespace

import numpy as np
import pytest

from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron
from meshfit.report.figures.figure import (
    WIDTHS,
    FigureStyle,
    details,
    latex_figure,
    plain_caption,
    result_lines,
    shows_sources,
)
from meshfit.report.figures.layout import DPI
from meshfit.report.figures.representative_trial import RepresentativeTrial, TargetTrials
from meshfit.report.tables.table import default_metric
from tests.cli import answered, refused
from tests.runs import complete, result_of

png = pytest.importorskip("PIL.Image", reason="figures need pyvista, matplotlib and pillow")
pytest.importorskip("pyvista")
pytest.importorskip("matplotlib")


@pytest.fixture
def coarse(monkeypatch):
    """Let pictures have few pixels, in tests that do not look at them."""
    for suffix in DPI:
        monkeypatch.setitem(DPI, suffix, 40)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    root = tmp_path_factory.mktemp("runs")
    ball = icosahedron()
    for scheme, size in (("loop", 0.8), ("interp-loop", 1.0)):
        for seed in range(3):
            folder = complete(root, "bone", scheme, seed)
            save_mesh(Mesh(size * ball.verts, ball.faces), folder / "source.ply")
            save_mesh(Mesh(ball.verts * [1.0, 0.3, 0.2], ball.faces), folder / "result.ply")
    return root


def test_pictures_that_would_be_too_small_are_refused(runs, tmp_path, monkeypatch):
    monkeypatch.setattr("meshfit.report.figures.figure.SMALLEST_PICTURE", 3.0)
    message = refused("figure", runs, "-o", tmp_path / "figure.png", "--width", "single")
    assert re.match(
        r"error: 1 target with 2 results each do not fit on one page: pictures would be [01]\.\d\d", message
    )
    assert message.endswith("; show some with --targets and --schemes, or give --width double")
    assert not any(tmp_path.iterdir())


def test_a_figure_is_written_with_its_captions(runs, tmp_path, coarse):
    message = answered("figure", runs, "-o", tmp_path / "figure.pdf")
    for name in ("figure.pdf", "figure.txt", "figure.tex"):
        assert name in message
        assert (tmp_path / name).stat().st_size > 100
    text = (tmp_path / "figure.txt").read_text()
    caption, about = text.split("\n\n")
    assert "the result of each scheme with its Hausdorff distance (median of 3 seeds)" in caption
    assert "tutorial frame" in caption
    assert 30 <= len(caption.split()) <= 50
    assert "the bone: loop seed 1, interp-loop seed 1" in about


def test_the_latex_has_no_comment_and_asks_for_the_figure(runs, tmp_path, coarse):
    answered("figure", runs, "-o", tmp_path / "my fig_1.png", "--metric", "hausdorff.percent_of_diagonal")
    latex = (tmp_path / "my fig_1.tex").read_text()
    assert not re.search(r"(?<!\\)%", re.sub(r"(?m)^%.*", "", latex))
    assert latex.startswith("% needs graphicx")
    assert r"\%" in latex
    assert r"\includegraphics[width=\textwidth]{my fig_1.png}" in latex
    assert r"\label{fig:my-fig-1}" in latex


def test_a_pdf_has_its_fonts_as_truetype_in_it_and_pictures_of_300_dpi(runs, tmp_path, monkeypatch):
    assert DPI[".pdf"] == 300
    monkeypatch.setitem(DPI, ".pdf", 100)
    answered("figure", runs, "-o", tmp_path / "figure.pdf", "--schemes", "loop")
    content = (tmp_path / "figure.pdf").read_bytes()
    assert b"/FontFile2" in content
    assert b"/Type3" not in content
    width = float(re.search(rb"/MediaBox \[ ?0 0 ([\d.]+)", content)[1])
    assert width == pytest.approx(72 * WIDTHS["double"])
    columns = 2  # target and result, with source and distances below
    widths = [int(found) for found in re.findall(rb"/Width (\d+)", content)]
    assert sum(width == pytest.approx(WIDTHS["double"] / columns * DPI[".pdf"], rel=0.1) for width in widths) == 4


def test_a_figure_is_as_wide_as_its_column_and_names_what_the_user_names(runs, tmp_path, coarse):
    labels = ["--label", "interp-loop=Interp. Loop", "--label", "bone=A bone"]
    answered("figure", runs, "-o", tmp_path / "one.png", "--width", "single", "--sources", "none", *labels)
    with png.open(tmp_path / "one.png") as image:
        across, _ = image.size
    assert across == pytest.approx(WIDTHS["single"] * DPI[".png"], abs=1)
    assert "A bone: loop seed 1, Interp. Loop seed 1" in (tmp_path / "one.txt").read_text()
    latex = (tmp_path / "one.tex").read_text()
    assert r"\begin{figure}" in latex
    assert r"\columnwidth" in latex
    assert "source" not in (tmp_path / "one.txt").read_text().partition("\n")[0]
    assert "did you mean 'loop'" in refused("figure", runs, "-o", tmp_path / "two.png", "--label", "lop=L")


@pytest.mark.slow
def test_a_png_is_for_a_screen(runs, tmp_path):
    answered("figure", runs, "-o", tmp_path / "one.png", "--schemes", "loop", "--targets", "bone")
    image = np.asarray(png.open(tmp_path / "one.png").convert("L"))
    assert image.shape[1] == pytest.approx(WIDTHS["double"] * DPI[".png"], abs=1)
    assert 0.02 < (image < 240).mean() < 0.8


def test_what_cannot_be_drawn_is_refused(runs, tmp_path):
    assert "no such run directory" in refused("figure", tmp_path / "nowhere", "-o", tmp_path / "x.pdf")
    assert ".docx" in refused("figure", runs, "-o", tmp_path / "x.docx")
    assert "cannot be written" in refused("figure", runs, "-o", tmp_path / "missing" / "x.pdf")
    assert "no result has the target 'cow'" in refused("figure", runs, "-o", tmp_path / "x.pdf", "--targets", "cow")
    assert "not a metric" in refused("figure", runs, "-o", tmp_path / "x.pdf", "--metric", "size")
    (tmp_path / "folder.pdf").mkdir()
    assert "folder.pdf" in refused("figure", runs, "-o", tmp_path / "folder.pdf")


def test_a_result_whose_mesh_is_gone_is_told_in_one_line(tmp_path):
    folder = complete(tmp_path, "bone")
    (folder / "result.ply").unlink()
    save_mesh(icosahedron(), folder / "source.ply")
    assert "result.ply: no such file" in refused("figure", tmp_path, "-o", tmp_path / "x.pdf")


def test_sources_are_shown_once_for_each_setting_of_the_source():
    def target(mesh, name="a"):
        return SimpleNamespace(selected=SimpleNamespace(settings={"source.mesh": mesh, "fit.steps": 3}, target=name))

    made = [target("auto", "a"), target("auto", "b"), target("auto", "b"), target("wrap", "b")]
    assert shows_sources(made, "once") == [True, True, False, True]
    targets = [target("icosahedron"), target("icosahedron", "b"), target("cube")]
    assert shows_sources(targets, "once") == [True, False, True]
    assert shows_sources(targets, "all") == [True, True, True]
    assert shows_sources(targets, "none") == [False, False, False]


def test_a_result_that_falls_short_is_marked_and_the_caption_says_how():
    short = result_of("cow") | {"shortfalls": ["topology not matched"]}
    trials = tuple(RepresentativeTrial(result, 0.1, 1) for result in (short, result_of("cow", "interp-loop")))
    target = SimpleNamespace(meshes=[], selected=TargetTrials("cow", "the cow", {"normalise": "box"}, trials))
    metric, style = "distance.mean", FigureStyle()
    assert [result_lines(trial, metric, style)[1] for trial in trials] == ["0.1000†", "0.1000"]
    assert "† falls short of its target" in plain_caption([target], metric, style)
    assert "† the cow, loop: topology not matched." in details([target], metric, style)
    assert r"\dag{} falls short" in latex_figure([target], metric, "figure.pdf", style)
    sound = SimpleNamespace(meshes=[], selected=TargetTrials("cow", "the cow", {}, trials[1:]))
    assert "†" not in " ".join([plain_caption([sound], metric, style), *details([sound], metric, style)])


def test_of_images_the_figure_names_what_stands_for_their_shape_and_masks_are_the_metric_without_one():
    masks = result_of("cow") | {"images": {"views": 4, "held_out": 0, "compared_with": "hull"}}
    selected = TargetTrials("cow", "the cow", {"normalise": "box"}, (RepresentativeTrial(masks, 0.9, 1),))
    lines = details([SimpleNamespace(meshes=[], selected=selected)], "iou.mean", FigureStyle())
    assert any("what distances are to, is the visual hull of the masks" in line for line in lines)
    known = masks | {"images": {**masks["images"], "compared_with": "truth"}}
    assert [default_metric([each]) for each in (masks, known)] == ["iou.mean", "hausdorff.symmetric"]
    assert default_metric([masks, known]) == "hausdorff.symmetric"


def test_no_source_is_shown_for_tools_that_work_from_the_target_alone():
    def target(tool):
        return SimpleNamespace(selected=SimpleNamespace(settings={"source.mesh": "sphere", "fit.tool": tool}))

    targets = [target("poisson"), target("nricp"), target("quadric"), target(None)]
    assert shows_sources(targets, "once") == [False, True, False, False]
    assert shows_sources(targets, "all") == [False, True, False, True]
