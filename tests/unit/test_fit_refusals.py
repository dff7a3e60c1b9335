"""Errors of a fit before its first step."""

import re

import numpy as np
import pytest
import torch

import meshfit
from meshfit.errors import ConfigError, DeviceError, MeshError
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron
from tests.fits import fit
from tests.loops import over


def refusal(kind, source=None, target=None, **changes):
    steps = {} if "steps" in changes else {"steps": 3}
    with pytest.raises(kind) as caught:
        fit(source or icosahedron(), target or cube(), on_step=pytest.fail, **({"device": "cpu"} | steps | changes))
    assert all("\n" not in fault for fault in caught.value.faults)
    assert caught.value.exit_code == 2
    return caught.value.faults[0]


@pytest.mark.parametrize(
    ("changes", "key", "found"),
    [
        ({"steps": -1}, "steps", "-1"),
        ({"steps": 1.5}, "steps", "1.5"),
        ({"steps": True}, "steps", "true"),
        ({"samples": 0}, "samples", "0"),
        ({"trace_every": 0}, "trace_every", "0"),
        ({"losses": {"edge": -1}}, "losses.edge", "-1"),
        ({"losses": {"edge": "1"}}, "losses.edge", '"1"'),
        ({"losses": 3}, "losses", "3"),
        ({"optimizer": {"lr": 0}}, "optimizer.lr", "0"),
        ({"optimizer": {"momentum": 1}}, "optimizer.momentum", "1"),
        ({"optimizer": {"name": "sgdm"}}, "optimizer.name", '"sgdm"'),
        ({"optimizer": {"schedule": {"factor": 0}}}, "optimizer.schedule.factor", "0"),
        ({"laplacian": "cot"}, "laplacian", '"cot"'),
        ({"method": "second-order"}, "method", '"second-order"'),
    ],
)
def test_a_value_that_is_not_allowed_is_named_with_its_key(changes, key, found):
    text = refusal(ConfigError, **changes)
    assert re.fullmatch(rf"{key}: (expected .*, )?got {re.escape(found)}(; .*)?", text)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize("changes", [lambda v: {"losses": {"edge": v}}, lambda v: {"optimizer": {"lr": v}}])
def test_numbers_that_are_not_finite_are_refused(changes, value):
    assert "expected a finite number" in refusal(ConfigError, **changes(value))


@pytest.mark.parametrize(
    ("changes", "key", "near"),
    [
        ({"step": 5}, "step", "steps"),
        ({"losses": {"edg": 1}}, "losses.edg", "edge"),
        ({"optimizer": {"learning_rate": 1, "momentun": 0.9}}, "optimizer.", "allowed: name, lr, momentum, schedule"),
        ({"optimizer": {"momentun": 0.9}}, "optimizer.momentun", "momentum"),
        ({"laplacain": "uniform"}, "laplacain", "laplacian"),
    ],
)
def test_an_unknown_keyword_is_refused_with_the_nearest_that_is_known(changes, key, near):
    text = refusal(ConfigError, **changes)
    assert text.startswith(key)
    assert "no such key" in text
    assert (near if near.startswith("allowed") else f"did you mean '{near}'?") in text


@pytest.mark.parametrize("dtype", ["float16", "double", "int32", ""])
def test_a_dtype_that_is_not_allowed_is_refused(dtype):
    text = refusal(ConfigError, dtype=dtype)
    assert text.startswith(f'dtype: got "{dtype}"')
    assert "allowed: float32, float64" in text


@pytest.mark.parametrize("threads", [0, -1])
def test_fewer_than_one_thread_is_refused(threads):
    assert refusal(ConfigError, threads=threads) == f"threads: expected a whole number of at least 1, got {threads}"


def test_a_device_that_does_not_exist_is_refused_with_what_is_allowed():
    assert "allowed: auto, cpu, cuda, cuda:N, mps" in refusal(DeviceError, device="gpu")


@pytest.mark.parametrize("device", ["cuda", "cuda:7", "mps"])
def test_a_device_that_is_not_there_is_refused(device, monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    assert f"'{device}' is not available" in refusal(DeviceError, device=device)


def test_double_precision_is_refused_where_the_device_has_none(monkeypatch):
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: True)
    assert "'mps' has no float64" in refusal(DeviceError, device="mps", dtype="float64")


def spoilt(mesh, vertex, value):
    verts = mesh.verts.copy()
    verts[vertex, 1] = value
    return Mesh(verts, mesh.faces)


@pytest.mark.parametrize("role", ["source", "target"])
@over("value", [np.nan, np.inf, -np.inf])
def test_a_coordinate_that_is_not_finite_is_refused_with_its_vertex(role, value):
    text = refusal(MeshError, **{role: spoilt(cube(), 5, value)})
    assert text.startswith(f"{role}: vertex 5 ")


NO_AREA = {
    "no faces": Mesh(cube().verts, np.empty((0, 3), dtype=int)),
    "nothing": Mesh(np.empty((0, 3)), np.empty((0, 3), dtype=int)),
    "all in one place": Mesh(np.ones((8, 3)), cube().faces),
    "on a line": Mesh(np.arange(8.0)[:, None] * np.ones(3), cube().faces),
}


@pytest.mark.parametrize("role", ["source", "target"])
@over("mesh", NO_AREA.values(), ids=NO_AREA)
def test_a_mesh_without_area_is_refused(role, mesh):
    assert refusal(MeshError, **{role: mesh}) == f"{role}: the mesh has no area"


def test_a_negative_seed_is_refused_as_in_a_config():
    for seed in (-1, True, 0.5, "0"):
        with pytest.raises(ConfigError, match="seed: expected a whole number of at least 0, got"):
            meshfit.Problem("octahedron", "octahedron", seed)
