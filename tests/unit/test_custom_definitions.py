"""Definitions in configs: refusals name key, line and remedy."""

import time

import pytest

from meshfit.config.loading import load_experiment
from meshfit.errors import ConfigError

MASKS = {"edge": "{end: 3/8, opposite: 1/8}", "boundary": "cubic-bspline"}


def mine(**changes):
    """The text of a definition; the line of its first key is 4."""
    entries = MASKS | changes
    return "mine:" + "".join(f"\n    {key}: {value}" for key, value in entries.items() if value is not None)


REFUSED = {
    "Loop: {base: loop}": "3: define.Loop: not a scheme name: lower-case letters, digits and single hyphens are",
    "my_loop: {base: loop}": "3: define.my_loop: not a scheme name",
    "my--loop: {base: loop}": "3: define.my--loop: not a scheme name",
    "my/loop: {base: loop}": "3: define.my/loop: not a scheme name",
    "..: {base: loop}": "3: define...: not a scheme name",
    "9: {base: loop}": "3: define.9: not a scheme name",
    f"{'a' * 61}: {{base: loop}}": f"3: define.{'a' * 61}: the name has 61 characters; 60 are allowed",
    "loop: {base: interp-loop}": "3: define.loop: a built-in scheme has this name; choose another",
    "mine: 3": "3: define.mine: expected a mapping of keys to values, got 3",
    "mine: null": "3: define.mine: expected a mapping of keys to values, got null",
    "mine: {}": "3: define.mine.edge: missing",
    "mine: {base: lop}": "3: define.mine.base: 'lop' is not a scheme: did you mean 'loop'?",
    "mine: {base: 'loop:'}": "3: define.mine.base: scheme 'loop:': expected 'key=value', got ''",
    "mine: {base: 'loop:alpha=1'}": "3: define.mine.base: scheme 'loop' has no parameter 'alpha'",
    "mine: {base: interp-loop}": "3: define.mine.base: 'interp-loop' is pushed back already; expected a scheme",
    "mine: {base: mine}": "3: define.mine.base: 'mine' is the definition itself; expected a scheme",
    "mine: {base: other}\n  other: {base: mine}": "3: define.mine.base: 'other' is a push-back too",
    "mine: {base: loop, alpha: 1.5}": "3: define.mine.alpha: expected a number of 1 or less, got 1.5",
    "mine: {base: loop, alpha: .nan}": "3: define.mine.alpha: expected a finite number, got NaN",
    "mine: {base: loop, aplha: 1}": "3: define.mine.aplha: no such key: did you mean 'alpha'? allowed: base, alpha",
    "mine: {base: loop, edge: {end: 1/2}}": "3: define.mine.edge: no such key: allowed: base, alpha",
    "mine: {base: [loop]}": '3: define.mine.base: expected text, got ["loop"]',
    mine(split="quad"): "6: define.mine.split: got \"quad\"; did you mean 'quadrisect'? allowed: quadrisect, sqrt3",
    mine(split="sqrt3"): "4: define.mine.edge: no such key: allowed: split, vertex, spokes, face, boundary",
    mine(edgy="3"): "6: define.mine.edgy: no such key: did you mean 'edge'?",
    mine(edge="{ends: 3/8, opposite: 1/8}"): "4: define.mine.edge.ends: no such key: did you mean 'end'?",
    mine(edge="{end: 3/7, opposite: 1/8}"): "4: define.mine.edge: the weights of an edge mask sum to 31/28, not to 1",
    mine(edge="{end: 0.51}"): "4: define.mine.edge: the weights of an edge mask sum to 51/50, not to 1",
    mine(edge="{end: 3/8 +, opposite: 1/8}"): "4: define.mine.edge.end: '3/8 +', character 6: it ends here; allowed",
    mine(edge="{end: n/6, opposite: 1/8}"): "4: define.mine.edge.end: 'n/6', character 1: 'n' is not known here",
    mine(edge="{end: 1/0}"): "4: define.mine.edge.end: '1/0' divides by zero",
    mine(edge="{end: true}"): "4: define.mine.edge.end: expected a number or a formula such as 3/8, found true",
    mine(edge="{end: .nan}"): "4: define.mine.edge.end: expected a number or a formula such as 3/8, found NaN",
    mine(edge="{end: .inf}"): "4: define.mine.edge.end: expected a number or a formula such as 3/8, found Infinity",
    mine(edge="{end: null}"): "4: define.mine.edge.end: expected a number or a formula such as 3/8, found null",
    mine(edge="{end: 1e400}"): "4: define.mine.edge.end: expected a number or a formula such as 3/8, found Infinity",
    mine(edge="{end: 500, opposite: -499.5}"): "4: define.mine.edge.end: '500' is 500; weights from -100 to 100 are",
    mine(
        edge="{end: 10^1^1*9^60*9^60*9^60*9^60*9^60*9^60}"
    ): "4: define.mine.edge.end: '10^1^1*9^60*9^60*9^60*9^60*9^60",
    mine(boundary="cubik-bspline"): "5: define.mine.boundary: got \"cubik-bspline\"; did you mean 'cubic-bspline'?",
    mine(boundary=None): "3: define.mine.boundary: missing",
    mine(vertex="1/(n-7)"): "6: define.mine.vertex: '1/(n-7)' divides by zero at n = 7",
    mine(vertex="sqrt(5-n)"): "6: define.mine.vertex: 'sqrt(5-n)' takes a root of a negative number at n = 6",
    mine(vertex="j"): "6: define.mine.vertex: 'j', character 1: 'j' is not known here",
    mine(vertex="[1]"): "6: define.mine.vertex: expected a number or a formula such as 3/8, found [1]",
    mine(vertex="{3: 1/2}"): "6: define.mine.vertex: expected an entry 'else'",
    mine(
        vertex="\n      3: 1/2\n      2: 1\n      else: 0"
    ): "8: define.mine.vertex.2: expected a valence from 3 to 99, or 'else'",
    mine(vertex="\n      3: 1/2\n      x: 1\n      else: 0"): "8: define.mine.vertex.x: expected a valence",
    mine(
        vertex="\n      3: 1/2\n      4: 1/\n      else: 0"
    ): "8: define.mine.vertex.4: '1/', character 3: it ends here",
    mine(
        vertex="\n      4: 1/2\n      else: 1/(n-3)"
    ): "8: define.mine.vertex.else: '1/(n-3)' divides by zero at n = 3",
    mine(
        vertex="\n      40: 1/(n-40)\n      else: 0"
    ): "7: define.mine.vertex.40: '1/(n-40)' divides by zero at n = 40",
    mine(spokes="{4: [1, 2], else: 0}"): "6: define.mine.spokes.4: expected one weight for each of 4 neighbours",
    mine(spokes="{4: [1, 2, j, 3], else: 0}"): "6: define.mine.spokes.4: 'j', character 1: 'j' is not known here",
    mine(spokes="{6: 1/n, else: 0}"): "6: define.mine.spokes.6: valence 6 is regular",
    mine(spokes="{else: [1, 2, 3]}"): "6: define.mine.spokes: expected a number or a formula such as 3/8, found [1",
    mine(spokes="1/(j-2)"): "6: define.mine.spokes: '1/(j-2)' divides by zero at n = 3, j = 2",
}


def test_what_is_no_definition_is_refused_with_its_line(tmp_path):
    path = tmp_path / "c.yaml"
    for text, message in REFUSED.items():
        path.write_text(f"schemes: [loop]\ndefine:\n  {text}\n")
        start = time.perf_counter()
        with pytest.raises(ConfigError) as caught:
            load_experiment(str(path))
        assert time.perf_counter() - start < 1
        assert all("\n" not in fault for fault in caught.value.faults)
        assert any(fault.startswith(f"{path}, line {message}") for fault in caught.value.faults)


def test_definitions_may_come_from_the_command_line(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("define: {mine: {base: loop, alpha: 0.5}}\nschemes: [loop, mine]\n")
    found = load_experiment(str(path), ["define={other: {base: sqrt3}}", "schemes=[mine, 'other:alpha=0.25']"]).settings
    assert found.schemes == ("mine", "other:alpha=0.25")
    assert list(found.define) == ["mine", "other"]
    changed = load_experiment(str(path), ["define.mine.alpha=0.25", "schemes=['mine:alpha=0.25']"]).settings
    assert changed.schemes == ("mine",)
    for override, said in {
        "define.mine.alpha=2": "--set: define.mine.alpha: expected a number of 1 or less, got 2",
        "define={other: {base: lop}}": "--set: define.other.base: 'lop' is not a scheme",
        "define=3": "--set: define: expected a mapping of keys to values, got 3",
        "schemes=[mien]": "--set: schemes[0]: 'mien' is not a scheme: did you mean 'mine'?",
    }.items():
        with pytest.raises(ConfigError) as caught:
            load_experiment(str(path), [override])
        assert str(caught.value).startswith(said)


def test_a_scheme_that_the_config_does_not_define_is_refused_where_it_stands(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("define: {mine: {base: loop}}\nschemes:\n  - loop\n  - mine:beta=1\n")
    with pytest.raises(ConfigError, match=r"c\.yaml, line 4: schemes\[1\]: scheme 'mine' has no parameter 'beta'"):
        load_experiment(str(path))
    path.write_text("define: {mine: {base: loop}}\nschemes: [mine, 'mine:alpha=1']\n")
    with pytest.raises(ConfigError, match=r"c\.yaml, line 2: schemes: duplicate entry mine"):
        load_experiment(str(path))


def test_a_definition_is_kept_as_it_was_written(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(f"define:\n  {mine(vertex='{3:  9 / 16 , else: 0.375}')}\nschemes: [mine]\n")
    kept = load_experiment(str(path)).settings.define["mine"]
    assert kept.model_dump(mode="json") == {
        "split": "quadrisect",
        "vertex": {"3": "9 / 16", "else": 0.375},
        "spokes": None,
        "edge": {"end": "3/8", "opposite": "1/8", "wing": 0.0},
        "boundary": "cubic-bspline",
    }
