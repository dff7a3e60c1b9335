"""A few kills of each kind; `make kills` runs them all."""

import sys

import pytest

from tests.kills import folders, signals
from tests.kills.experiments import undisturbed
from tests.kills.folders import Loss
from tests.kills.signals import Chain, Kill

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")]

KILLS = (
    Kill("starting", "run", "KILL"),
    Kill("importing", "worker", "HUP"),
    Kill("checkpoint-writing", "group", "KILL"),
    Kill("measuring", "worker", "SEGV"),
    Kill("renaming", "run", "TERM"),
    Kill("finishing", "group", "INT"),
)


@pytest.mark.parametrize(("engine", "workers"), [("first-order", 2), ("gauss-newton", 1)])
def test_kills_at_known_moments_lose_nothing_and_change_nothing(tmp_path, engine, workers):
    reference = undisturbed(tmp_path / "undisturbed", engine, len(KILLS))
    reported = []
    signals.disturb(Chain(engine, workers, KILLS, {}), tmp_path / "killed", reference, reported.append)
    assert len(reported) == len(KILLS)


def test_a_disk_that_is_full_loses_nothing_where_none_can_be_mounted(tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "mount_command", lambda _: ["false"])
    losses = tuple(Loss("full", phase) for phase in ("fitting", "measuring"))
    reference = undisturbed(tmp_path / "undisturbed", "first-order", len(losses))
    reported = []
    folders.disturb(folders.Chain("first-order", losses), tmp_path / "full", reference, reported.append)
    assert len(reported) == len(losses)


def test_every_signal_hits_every_victim_at_every_phase():
    kills = [kill for chain in signals.chains({}) for kill in chain.kills]
    assert len(kills) == len(set(kills)) == 29 * 8
