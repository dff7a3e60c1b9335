"""Fixtures that tests of several folders use."""

import jaxtyping
import pytest
from hypothesis import HealthCheck, settings

# Whether an example is made in time says how busy the machine is.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


@pytest.fixture
def fewer_target_points(monkeypatch):
    """Let Gauss–Newton fits sample 5,000 points of their target instead of 200,000, most of the time of a small fit."""
    monkeypatch.setattr("meshfit.fitting.gauss_newton.target._POINTS", 5_000)


@pytest.fixture(scope="module")
def without_shape_checks():
    """Leave shapes and dtypes unchecked in tests that repeat whole fits, in which the checks take half of the time.

    The functions that these fits call are checked in tests of single fits.
    """
    jaxtyping.config.update("jaxtyping_disable", "1")
    yield
    jaxtyping.config.update("jaxtyping_disable", "0")


@pytest.fixture(autouse=True)
def without_fsync(monkeypatch):
    """Leave out the wait for the disk, of which no test in this process can notice the effect."""
    monkeypatch.setattr("os.fsync", lambda _: None)
