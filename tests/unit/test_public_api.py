"""The public names: documented, with examples that run, and nothing else in `dir(meshfit)`."""

import doctest
import inspect
import io
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

import meshfit

NAMES = [name for name in dir(meshfit) if name != "__version__"]


def test_dir_lists_the_public_names_and_nothing_else():
    assert dir(meshfit) == sorted(meshfit.__all__)
    assert {"fit", "measure", "as_mesh", "Mesh", "subdivide", "save_mesh", "__version__"} <= set(NAMES) | {
        "__version__"
    }
    assert not [name for name in NAMES if name.startswith("_") or inspect.ismodule(getattr(meshfit, name))]


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_has_a_docstring_with_an_example_that_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    thing = getattr(meshfit, name)
    (example,) = doctest.DocTestFinder(recurse=False).find(thing, name, globs={})
    assert example.examples, f"{name}: no example"
    assert not any(part.options for part in example.examples), f"{name}: an example is skipped"
    report = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    runner.run(example, out=report.append)
    assert not runner.failures, "".join(report)


WRONG = {
    "None": None,
    "a number": 3,
    "a fraction": 1.5,
    "not a number": float("nan"),
    "texts": ["a", "b"],
    "no text": "",
    "bytes": b"x",
    "a tensor": torch.zeros(4, 3),
    "an array": np.zeros(3),
    "an open file": io.StringIO("x"),
    "a path": Path("missing.ply"),
    "a scene": trimesh.Scene(),
    "a dict": {"done": 1},
    "a set": {1},
    "a class": meshfit.Mesh,
    "an object": object(),
}
# An argument that each required parameter of that name takes; settings that keep the calls short.
RIGHT = {"scheme": "loop", "degrees": 60, "path": "out.ply", "source": "icosahedron", "problems": [], "curves": None}
CALLBACKS = ("on_step", "save", "on_snapshot")
SHORT = {
    "fit": {"steps": 1, "samples": 9, "device": "cpu"},
    "fit_batch": {"problems": [meshfit.Problem("icosahedron", "cube")], "steps": 1, "samples": 9, "device": "cpu"},
    "measure": {"samples": 100, "points": 100},
    "read_tables": {"metrics": ()},
}


def _calls(function):
    """Arguments of calls: each parameter in turn with each wrong value, and the others right."""
    parameters = inspect.signature(function).parameters.values()
    required = [each.name for each in parameters if each.default is each.empty and each.kind is not each.VAR_KEYWORD]
    defaults = {each.name: each.default for each in parameters}
    names = [each.name for each in parameters if each.kind not in (each.VAR_KEYWORD, each.VAR_POSITIONAL)]
    right = {name: RIGHT.get(name, "cube") for name in required if name in names} | SHORT.get(function.__name__, {})
    for name in names:
        for kind, value in WRONG.items():
            if value is defaults[name] or (callable(value) and name in CALLBACKS):
                continue
            yield f"{name}: {kind}", right | {name: value}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", [name for name in NAMES if inspect.isfunction(getattr(meshfit, name))])
def test_every_function_takes_or_refuses_each_value_with_an_error_of_ours_in_one_line(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    function = getattr(meshfit, name)
    for call, arguments in _calls(function):
        faults = ()
        try:
            function(**arguments)
        except meshfit.MeshfitError as error:
            faults = error.faults
        except Exception as error:
            error.add_note(f"in meshfit.{name}, {call}")
            raise
        assert not [fault for fault in faults if "\n" in fault], (call, faults)
