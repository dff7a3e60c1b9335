"""Overlays of results on masks: colours where the two differ, and which views are shown."""

import numpy as np
import pytest

from meshfit.images.files import renamed
from meshfit.images.rasteriser import render_view
from meshfit.images.sphere_cameras import cameras_around
from meshfit.images.target import ImageTarget
from meshfit.images.views import Views
from meshfit.measuring.mask_overlap import mask_ious
from meshfit.report.figures.colours import MASK, RESULT, rgb
from meshfit.report.figures.view_overlay import draw_overlay, shown_views
from meshfit.subdivision.sphere import icosphere
from tests.loops import over


def views_of(mesh, count, prefix="view-", kind="pinhole"):
    return Views(renamed((render_view(mesh, camera) for camera in cameras_around(mesh, count, 48, kind=kind)), prefix))


def share(picture, colour):
    """Return the share of the pixels that have a colour at some opacity."""
    near = np.abs(picture[:, :, :3].astype(int) - rgb(colour).astype(int)).max(axis=2) <= 3
    return (near & (picture[:, :, 3] > 0)).mean()


@over("kind", ["pinhole", "orthographic"])
def test_the_colours_show_what_is_missing_and_what_is_too_much(kind):
    ball = icosphere(3)
    view = views_of(ball, 1, kind=kind)[0]
    small, large = (ball.with_verts(factor * ball.verts) for factor in (0.5, 2.0))
    side = 1.2 * view.mask.any(axis=0).sum()
    disc, image, line = view.mask.sum() / side**2, min(1.0, 48 / side) ** 2, 2 * np.pi * 3 / 90
    for mesh, missing, outside in ((small, 0.75 * disc, 0.0), (large, 0.0, image - disc)):
        picture, iou = draw_overlay(mesh, view, 90)
        assert picture.shape == (90, 90, 4)
        assert iou == mask_ious(mesh, Views([view]))[0]
        assert missing - 0.1 <= share(picture, MASK) <= missing + line
        assert outside - 0.1 <= share(picture, RESULT) <= outside + line
    picture, iou = draw_overlay(ball, view, 90)
    assert iou == 1.0
    assert picture[45, 45, 3] < 100
    assert picture[0, 0, 3] == 0
    assert share(picture, RESULT) < line


def test_the_picture_is_a_square_around_a_mask_at_the_border_of_the_image():
    ball = icosphere(2)
    view = views_of(ball, 1)[0]
    shifted = ball.with_verts(ball.verts + 0.9 * view.camera.pose[:3, 0])
    seen = render_view(shifted, view.camera)
    assert seen.mask[:, -1].any()
    picture, iou = draw_overlay(shifted, seen, 60)
    assert iou == pytest.approx(1.0)
    assert not picture[:, -2:, 3].any()  # beyond the image


def test_views_are_spread_over_their_order_and_hold_the_worst():
    views, others = views_of(icosphere(1), 12), views_of(icosphere(1), 2, "held-out-")
    shown = shown_views(ImageTarget(views, None, "ball", others), ["view-07"])
    assert [view.title for view in shown] == ["view-02", "view-07", "view-10", "held-out-00", "held-out-01"]
    assert [view.held_out for view in shown] == [False] * 3 + [True] * 2
    few, aside = views.held_out(10)
    assert [view.title for view in shown_views(ImageTarget(few, None, "ball", aside))][-1].endswith(", held out")
