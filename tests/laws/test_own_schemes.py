"""User-defined schemes: equal to built-in ones with the same masks, and under the same laws."""

from fractions import Fraction

import numpy as np
import pytest

from meshfit.errors import SchemeError
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.settings import build
from meshfit.subdivision.limit import has_loop_limit
from meshfit.subdivision.refine import refine
from meshfit.subdivision.registry import NamedScheme, UserSchemes, canonical, registry_with, resolve
from tests.loops import over
from tests.shapes import fan, mixed_closed, mixed_open, patch, wheel

LOOP_RING = "5/8 - (3/8 + cos(2*pi/n)/4)^2"
LOOP = {"edge": {"end": "3/8", "opposite": "1/8"}, "vertex": LOOP_RING, "boundary": "cubic-bspline"}
WARREN = LOOP | {"vertex": {3: "9/16", "else": "3/8"}}
BUTTERFLY = {"edge": {"end": "1/2", "opposite": "2/16", "wing": "-1/16"}, "boundary": "four-point"}
SQRT3 = {"split": "sqrt3", "face": {"corner": "1/3"}, "vertex": "(4 - 2*cos(2*pi/n))/9", "boundary": "ternary-bspline"}
ZORIN = {
    3: ["5/12", "-1/12", "-1/12"],
    4: ["3/8", 0, "-1/8", 0],
    "else": "(1/4 + cos(2*pi*j/n) + cos(4*pi*j/n)/2)/n",
}
A = "(2*cos(pi/n)/3)"
LABSIK = {
    3: ["4/27", "4/27", "-5/27"],
    4: ["2/9", "2/9", "-1/9", "-1/9"],
    "else": f"({A}^2 + 2*{A}*cos((2*j-1)*pi/n) + 2*{A}^2*cos(2*(2*j-1)*pi/n))/n",
}
OWN = {
    "my-midpoint": {"edge": {"end": "1/2"}, "boundary": "linear"},
    "my-loop": LOOP | {"split": "quadrisect"},
    "my-warren": WARREN,
    "my-butterfly": BUTTERFLY,
    "my-modified-butterfly": BUTTERFLY | {"spokes": ZORIN},
    "my-sqrt3": SQRT3,
    "my-interp-sqrt3": {
        "split": "sqrt3",
        "face": {"corner": "32/81", "across": "-1/81", "wing": "-2/81"},
        "spokes": LABSIK,
        "boundary": "ternary-four-point",
    },
    "my-interp-loop": {"base": "loop"},
    "my-interp-warren": {"base": "loop:weights=warren", "alpha": 0.25},
    "my-interp-my-loop": {"base": "my-loop", "alpha": 0.5},
}
EQUAL = {
    "my-midpoint": "midpoint",
    "my-loop": "loop",
    "my-warren": "loop:weights=warren",
    "my-butterfly": "butterfly",
    "my-modified-butterfly": "modified-butterfly",
    "my-sqrt3": "sqrt3",
    "my-interp-sqrt3": "interp-sqrt3",
    "my-interp-loop": "interp-loop",
    "my-interp-loop:alpha=0.3": "interp-loop:alpha=0.3",
    "my-interp-warren": "interp-loop:weights=warren,alpha=0.25",
    "my-interp-warren:alpha=1": "interp-loop:weights=warren",
    "my-interp-my-loop": "interp-loop:alpha=0.5",
}
# Sums of cosines are rounded differently where the centre is what is left to one.
ROUNDED = {"my-modified-butterfly", "my-interp-sqrt3"}
DEFINED = build(UserSchemes, {"define": OWN}).define
REGISTRY = registry_with(DEFINED)
MESHES = {"closed": mixed_closed, "open": mixed_open, "patch": lambda: patch(5, 4), "fan": lambda: fan(5)}


def matrix(spec, mesh, levels=2):
    return refine(Topology.of(mesh), resolve(spec, REGISTRY), levels).matrix.toarray()


@pytest.mark.parametrize("spec", EQUAL)
@over("shape", MESHES)
def test_the_operators_are_those_of_the_built_in_schemes(spec, shape):
    mesh = MESHES[shape]()
    ours, theirs = matrix(spec, mesh), refine(Topology.of(mesh), resolve(EQUAL[spec]), 2).matrix.toarray()
    if spec in ROUNDED:
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-15)
    else:
        assert np.array_equal(ours, theirs)


@over("valence", [3, 4, 5, 7, 12, 30])
@pytest.mark.parametrize("spec", EQUAL)
def test_so_they_are_at_extraordinary_verts(spec, valence):
    mesh = wheel(valence, 3)
    ours, theirs = matrix(spec, mesh, 1), refine(Topology.of(mesh), resolve(EQUAL[spec]), 1).matrix.toarray()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", OWN)
def test_the_kind_is_that_of_the_masks(name):
    kept = matrix(name, mixed_open())[: mixed_open().num_verts]
    assert np.array_equal(kept, np.eye(len(kept))) == (REGISTRY[name].kind == "interpolatory")


def test_masks_are_exact_fractions():
    scheme = resolve("my-butterfly", REGISTRY)
    assert (scheme.inserted.end, scheme.inserted.wing) == (Fraction(1, 2), Fraction(-1, 16))
    decimal = build(UserSchemes, {"define": {"mine": {"edge": {"end": 0.3, "wing": 0.1}, "boundary": "linear"}}}).define
    assert resolve("mine", registry_with(decimal)).inserted.wing == Fraction(1, 10)


ODD = {
    "edge": {"end": "sqrt(2)/4", "opposite": "1/2 - sqrt(2)/4 - 2*0.07", "wing": 0.07},
    "vertex": "min(1/n, 0.3) + sin(n)/100",
    "spokes": {5: [0.1, "1/7", 0, -0.2, "sqrt(n)/9"], "else": "cos(j)/n^2"},
    "boundary": "four-point",
}
ODD_SQRT3 = {
    "split": "sqrt3",
    "face": {"corner": "0.3", "wing": "0.1/6"},
    "vertex": "1/n",
    "spokes": "j/n^2",
    "boundary": "ternary-four-point",
}
ANY = build(
    UserSchemes, {"define": {"odd": ODD, "odd-sqrt3": ODD_SQRT3, "pushed": {"base": "odd", "alpha": 0.7}}}
).define


@over("shape", MESHES)
@pytest.mark.parametrize("spec", ["odd", "odd-sqrt3", "pushed", "pushed:alpha=0.1"])
def test_whatever_is_declared_is_affinely_invariant(spec, shape):
    mesh, scheme = MESHES[shape](), resolve(spec, registry_with(ANY))
    refinement = refine(Topology.of(mesh), scheme, 2)
    np.testing.assert_allclose(refinement.matrix.sum(axis=1), 1, atol=1e-12)
    turned = np.random.default_rng(3).normal(size=(3, 3))
    ours, theirs = refinement(mesh.verts @ turned + 2), refinement(mesh.verts) @ turned + 2
    np.testing.assert_allclose(ours, theirs, atol=1e-11)


@pytest.mark.parametrize("spec", ["odd", "odd-sqrt3", "pushed"])
def test_numbers_of_verts_do_not_matter(spec):
    mesh, scheme = mixed_closed(), resolve(spec, registry_with(ANY))
    order = np.random.default_rng(0).permutation(mesh.num_verts)
    place = np.argsort(order)
    moved = Mesh(mesh.verts[order], place[mesh.faces])
    ours, theirs = (refine(Topology.of(each), scheme, 1)(each.verts) for each in (moved, mesh))
    np.testing.assert_allclose(ours[: len(order)], theirs[: len(order)][order], atol=1e-14)
    new = [np.unique(np.round(each[len(order) :], 10), axis=0) for each in (ours, theirs)]
    np.testing.assert_allclose(*new, atol=1e-9)


def test_weights_are_asked_for_at_valences_that_occur():
    define = build(UserSchemes, {"define": {"mine": LOOP | {"vertex": "1/(n-2) + 1/(n-20) - 1/(n-1)"}}}).define
    scheme = resolve("mine", registry_with(define))
    assert refine(Topology.of(wheel(12, 2)), scheme, 1).matrix.shape[0] > 0
    with pytest.raises(SchemeError, match=r"^mine: vertex: '1/\(n-2\).*' divides by zero at n = 20$"):
        refine(Topology.of(wheel(20, 2)), scheme, 1)


def test_own_loop_has_loops_limit():
    assert has_loop_limit(resolve("my-loop", REGISTRY))
    assert not has_loop_limit(resolve("my-interp-my-loop", REGISTRY))


def test_specs_have_one_form_and_own_names_are_suggested():
    assert canonical("my-interp-warren:alpha=0.25", REGISTRY) == "my-interp-warren"
    assert canonical("my-interp-loop:alpha=1", REGISTRY) == "my-interp-loop"
    for spec, message in {
        "my-lop": "did you mean 'my-loop'?",
        "my-loop:alpha=1": "scheme 'my-loop' has no parameter 'alpha': it takes none",
        "my-interp-loop:weights=warren": "has no parameter 'weights': allowed: alpha",
        "my-interp-loop:alpha=2": "alpha=2 is not allowed: expected a number from 0 to 1",
    }.items():
        with pytest.raises(SchemeError) as caught:
            resolve(spec, REGISTRY)
        assert message in str(caught.value)


def test_a_scheme_hangs_on_its_definition_and_on_that_of_its_base_alone():
    assert [name for name, _ in NamedScheme.of("my-interp-my-loop:alpha=0.2", DEFINED).own] == [
        "my-interp-my-loop",
        "my-loop",
    ]
    assert NamedScheme.of("my-interp-loop", DEFINED).own == (("my-interp-loop", DEFINED["my-interp-loop"]),)
    assert NamedScheme.of("loop", DEFINED).own == ()
    assert hash(NamedScheme.of("my-warren", DEFINED)) == hash(NamedScheme.of("my-warren", dict(DEFINED)))
