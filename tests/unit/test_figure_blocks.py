"""The arrangement of a figure's blocks on its page."""

import itertools

import pytest

from meshfit.report.figures.figure_layout import TALLEST, BlockShape, arrange, wrapped
from tests.loops import over


def shapes(targets, schemes, aspect):
    texts = (("interp-loop", "0.01234"),)
    return [BlockShape(2, 1 + schemes, aspect, 1 + 2 * schemes, texts) for _ in range(targets)]


@pytest.mark.slow
@over("case", list(itertools.product(range(1, 9), range(1, 7), (0.6, 1.3, 2.5), (3.33, 7.0))))
def test_every_number_of_targets_and_schemes_fits_its_page_and_fills_its_width_or_height(case):
    targets, schemes, aspect, width = case
    blocks = shapes(targets, schemes, aspect)
    found = arrange([blocks], width, 8.0)
    across = found.columns * ((1 + schemes) * (found.cell + 0.05) + 0.46) + 0.16 * (found.columns - 1)
    high = sum(blocks[0].height(found.cell, 8.0) for _ in range(0, targets, found.columns))
    assert across <= width + 1e-6
    assert high <= TALLEST + 1e-6
    assert across > 0.99 * width or high > 0.99 * TALLEST
    others = [arrange([blocks], width, 8.0, count) for count in range(1, targets + 1)]
    assert found.cell >= 0.7 * max(other.cell for other in others)


def test_more_columns_than_targets_are_as_many_as_targets():
    assert arrange([shapes(2, 1, 1.0)], 7.0, 8.0, 5).columns == 2


def test_text_is_wrapped_to_its_picture():
    lines = wrapped(["a rather long name of a scheme", "0.01"], 0.8, 8.0)
    assert lines[-1] == "0.01"
    assert all(len(line) <= 0.85 * 72 / (0.47 * 8.0) for line in lines)
    assert pytest.approx(len(lines), abs=1) == 3
