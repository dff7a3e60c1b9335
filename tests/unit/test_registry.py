"""Scheme specs: reading, refusing with the remedy named, and one canonical form."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshfit.errors import SchemeError
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.registry import SCHEMES, canonical, entry_of, resolve
from tests.loops import over
from tests.shapes import mixed_open

CANONICAL = {
    "loop": "loop",
    " loop ": "loop",
    "loop:weights=loop": "loop",
    "loop:weights=warren": "loop:weights=warren",
    "interp-loop:alpha=1": "interp-loop",
    "interp-loop:alpha=1.0,valence3=displacement,weights=loop": "interp-loop",
    "interp-loop:alpha=0": "interp-loop:alpha=0.0",
    "interp-loop:alpha=.5": "interp-loop:alpha=0.5",
    "interp-loop:alpha=5e-1": "interp-loop:alpha=0.5",
    "interp-loop: valence3 = zorin, alpha = 0.25": "interp-loop:alpha=0.25,valence3=zorin",
    "butterfly:tension=0.0625": "butterfly",
    "butterfly:tension=0": "butterfly:tension=0.0",
}


@over(("text", "expected"), CANONICAL.items())
def test_canonical_form(text, expected):
    assert canonical(text) == expected
    assert canonical(expected) == expected


@over("text", CANONICAL)
def test_canonical_form_means_the_same(text):
    mesh = mixed_open()
    assert (subdivide(mesh, text).verts == subdivide(mesh, canonical(text)).verts).all()


def value_of(parameter):
    if isinstance(parameter.default, str):
        return st.sampled_from(parameter.allowed)
    low, high = parameter.allowed
    return st.floats(low, high)


SPECS = st.sampled_from(sorted(SCHEMES)).flatmap(
    lambda name: st.tuples(
        st.just(name),
        st.fixed_dictionaries({}, optional={k: value_of(p) for k, p in SCHEMES[name].parameters.items()}),
    )
)


@given(SPECS)
def test_canonical_form_is_read_back_to_the_same_parameters(spec):
    name, parameters = spec
    text = name + (":" + ",".join(f"{k}={v!r}" for k, v in parameters.items()) if parameters else "")
    text = text.replace("'", "")
    short = canonical(text)
    assert canonical(short) == short
    defaults = {key: parameter.default for key, parameter in SCHEMES[name].parameters.items()}
    pairs = [part.split("=") for part in short.partition(":")[2].split(",") if part]
    back = defaults | {k: v if isinstance(defaults[k], str) else float(v) for k, v in pairs}
    assert back == defaults | parameters
    assert [key for key, _ in pairs] == [key for key in defaults if back[key] != defaults[key]]


@over("name", SCHEMES)
def test_every_scheme_can_be_asked_for_by_its_name(name):
    assert entry_of(name) is SCHEMES[name]
    scheme = resolve(name)
    defaults = {key: parameter.default for key, parameter in SCHEMES[name].parameters.items()}
    assert scheme.split is SCHEMES[name].declare(**defaults).split
    assert canonical(name) == name


def test_parameters_given_apart_take_precedence_and_none_stands_for_not_given():
    assert resolve("interp-loop:alpha=0.5", alpha=0.25).alpha == 0.25
    assert resolve("interp-loop:alpha=0.5", alpha=None).alpha == 0.5
    assert resolve("interp-loop", alpha=0.5, valence3="zorin").at_valence3 is not None
    assert resolve("interp-loop").at_valence3 is None
    assert resolve("interp-loop").alpha == 1


REFUSED = {
    "lop": r"'lop' is not a scheme: did you mean 'loop'\?",
    "interp_loop": r"did you mean 'interp-loop'\? allowed: midpoint, loop,",
    "modified-buterfly": "did you mean 'modified-butterfly'",
    "Loop": "'Loop' is not a scheme",
    "nothing-like-it": "allowed: .*interp-sqrt3",
    "": "expected a name or",
    "loop:": "expected 'key=value', got ''",
    "interp-loop:alpha": "expected 'key=value', got 'alpha'",
    "interp-loop:alpha=": "expected 'key=value', got 'alpha='",
    "interp-loop:alfa=1": "no parameter 'alfa': did you mean 'alpha'",
    "loop:alpha=1": "scheme 'loop' has no parameter 'alpha': allowed: weights",
    "midpoint:alpha=1": "scheme 'midpoint' has no parameter 'alpha': it takes none",
    "interp-loop:alpha=nan": "alpha=nan is not allowed: expected a number from 0 to 1",
    "interp-loop:alpha=inf": "alpha=inf is not allowed",
    "interp-loop:alpha=-0.01": "alpha=-0.01 is not allowed",
    "interp-loop:alpha=1.01": "interp-loop: alpha=1.01 is not allowed",
    "interp-loop:alpha=half": "alpha=half is not allowed: expected a number from 0 to 1",
    "butterfly:tension=0.126": "tension=0.126 is not allowed: expected a number from 0 to 0.125",
    "loop:weights=waren": "weights=waren is not allowed: did you mean 'warren'",
    "loop:weights=1": "weights=1 is not allowed: allowed: loop, warren",
    "interp-loop:valence3=zorn": "did you mean 'zorin'",
}


@over(("text", "message"), REFUSED.items())
def test_what_is_not_allowed_is_refused_with_what_is(text, message):
    for reader in (resolve, canonical):
        with pytest.raises(SchemeError, match=message):
            reader(text)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"alpha": float("nan")}, "alpha=nan is not allowed"),
        ({"alpha": 2}, "alpha=2 is not allowed"),
        ({"alpha": "1"}, "alpha=1 is not allowed"),
        ({"beta": 1}, "no parameter 'beta'"),
        ({"valence3": 3}, "valence3=3 is not allowed"),
    ],
)
def test_parameters_given_apart_are_checked_too(parameters, message):
    with pytest.raises(SchemeError, match=message):
        resolve("interp-loop", **parameters)
