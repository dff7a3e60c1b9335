"""Fixtures that tests of several folders use."""

import pytest


@pytest.fixture
def fewer_target_points(monkeypatch):
    """Let Gauss–Newton fits sample 5,000 points of their target instead of 200,000, most of the time of a small fit."""
    monkeypatch.setattr("meshfit.fitting.gauss_newton.target._POINTS", 5_000)
