import io
import re

import numpy as np
import pytest

from meshfit.errors import ConfigError
from meshfit.report.figures.layout import (
    SUFFIXES,
    ColourBar,
    Panel,
    PanelRow,
    Ring,
    column_width,
    require_suffix,
    write_rows,
)

png = pytest.importorskip("PIL.Image", reason="plates need matplotlib and pillow")
pytest.importorskip("matplotlib")

BAR = ColourBar(0.25, "distance, in metres", more=True)
WIDTH, DPI = 4.0, 100


def picture(*colour, wide=150, high=60):
    return np.full((high, wide, 4), [*colour, 255], dtype=np.uint8)


def row(*lines, ring=None, bar=None, free=0):
    panels = [Panel(picture(200, 30, 30), lines, ring), Panel(picture(30, 30, 200), lines)]
    return PanelRow((*[None] * free, *panels), bar)


def written(rows, path):
    write_rows(rows, path, width=WIDTH, font=8.0, dpi=DPI)
    return path.read_bytes()


def image(content):
    return np.asarray(png.open(io.BytesIO(content)).convert("RGB")).astype(int)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_same_plate_gives_the_same_bytes(tmp_path, suffix):
    rows = [row("one", "two", ring=Ring(20, 20, dashed=True)), row(bar=BAR)]
    assert written(rows, tmp_path / f"one{suffix}") == written(rows, tmp_path / f"two{suffix}")


def test_pictures_are_where_they_should_be_pixel_for_pixel(tmp_path):
    found = image(written([row()], tmp_path / "x.png"))
    assert found.shape[1] == WIDTH * DPI
    column = column_width(WIDTH, 2) * DPI
    for left, colour in ((column / 2, [200, 30, 30]), (WIDTH * DPI - column / 2, [30, 30, 200])):
        middle = round(left)
        assert (found[5:55, middle - 70 : middle + 70] == colour).all()
    assert (found == [200, 30, 30]).all(axis=2).sum() == 150 * 60


def test_text_rings_and_bars_add_ink_and_take_room(tmp_path):
    plain, text, ring = (
        image(written([each], tmp_path / "x.png"))
        for each in (row(), row("a line"), row(ring=Ring(30, 30, dashed=False)))
    )
    assert len(text) > len(plain)
    assert (text[60:].min(axis=2) < 150).any()
    assert (ring != plain).any()
    for free in (0, 1):
        barred = image(written([row(bar=BAR, free=free)], tmp_path / "x.png"))
        assert (np.ptp(barred[:, : 300 if free == 0 else 120], axis=2) > 60).any()
        assert len(barred) > len(plain) or free


def test_a_pdf_embeds_truetype_and_keeps_its_text(tmp_path):
    content = written([row("text")], tmp_path / "x.pdf")
    assert b"/FontFile2" in content
    assert b"/Type3" not in content
    assert re.search(rb"/MediaBox \[ ?0 0 288 ", content)


def test_long_lines_and_letters_that_no_font_has_do_no_harm(tmp_path):
    found = image(written([row("a very long line, " * 20, "\U0001f400 $x_y$")], tmp_path / "x.png"))
    assert (found[:, 199:201] > 250).all()  # nothing runs from one column into the next
    short = image(written([row("Hausdorff distance")], tmp_path / "x.png"))
    long = image(written([row("Hausdorff distance from the result to the target 0.1176")], tmp_path / "x.png"))
    assert len(long) > len(short)  # broken into lines, and not cut


def test_where_nothing_can_be_written_is_known_at_once(tmp_path):
    for name in ("x.gif", "x", "missing/x.png"):
        with pytest.raises(ConfigError, match=name):
            require_suffix(tmp_path / name)
    require_suffix(tmp_path / "x.PDF")
