"""The public names: documented, with examples that run, and nothing else in `dir(meshfit)`."""

import doctest
import inspect

import pytest

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
