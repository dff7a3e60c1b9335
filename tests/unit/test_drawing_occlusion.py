import numpy as np
import pytest

from meshfit.report.figures.drawing import occlusion_shade

ROWS, COLUMNS = np.mgrid[0:120, 0:140].astype(np.float32)
FAR = np.float32(np.inf)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (1.0, 0.5), (-2.0, 3.0)])
def test_a_plane_stays_as_it_is_however_it_leans(slope):
    plane = 500 + slope[0] * ROWS + slope[1] * COLUMNS
    assert occlusion_shade(plane.astype(np.float32))[20:-20, 20:-20] == pytest.approx(1.0, abs=1e-5)


def test_a_hill_stays_and_a_hollow_gets_dark():
    bump = np.float32(25) * np.exp(-((ROWS - 60) ** 2 + (COLUMNS - 70) ** 2) / 50)
    hill, hollow = occlusion_shade(500 - bump), occlusion_shade(500 + bump)
    assert hill[60, 70] == pytest.approx(1.0, abs=1e-5)
    assert hollow[60, 70] < 0.75
    assert (hollow > 0).all()
    assert (hollow <= 1).all()


def test_what_stands_free_is_not_darkened_by_what_is_far_behind_or_in_front():
    bar = np.abs(COLUMNS - 70) < 10
    for behind in (FAR, np.float32(10_000)):
        shade = occlusion_shade(np.where(bar, np.float32(500), behind))
        assert shade[20:-20][bar[20:-20]] == pytest.approx(1.0, abs=1e-5)
        assert shade[60, 20] == pytest.approx(1.0, abs=1e-5)


def test_the_background_stays_as_it_is():
    assert (occlusion_shade(np.full((30, 30), FAR)) == 1).all()
