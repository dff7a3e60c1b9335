"""Schemes on curves and on surfaces refuse each other's input, and curves that branch; each in one line."""

from fractions import Fraction

import numpy as np
import pytest

import meshfit
from meshfit.config.loading import load_experiment
from meshfit.config.source_settings import SourceSettings
from meshfit.errors import ConfigError, MeshError, SchemeError
from meshfit.experiment.source import build_source
from meshfit.mesh.curves import Chains, Curves
from meshfit.mesh.solids import octahedron
from meshfit.mesh.topology import Topology
from meshfit.subdivision.curves.scheme import CurveScheme, CurveSplit
from meshfit.subdivision.curves.table import CURVE_SCHEMES
from meshfit.subdivision.masks import KEPT, LINEAR, CurveMask, four_point
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import SCHEMES, domain_of, resolve
from meshfit.subdivision.triangles.table import TRIANGLE_SCHEMES
from tests.curve_shapes import single
from tests.loops import over

by_curve_scheme = over("name", CURVE_SCHEMES)
ON_CURVES, ON_TRIANGLES = ", ".join(CURVE_SCHEMES), ", ".join(TRIANGLE_SCHEMES)


@by_curve_scheme
@over("levels", [0, 1])
def test_a_scheme_on_curves_on_a_mesh(name, levels):
    text = f"^a scheme on curves cannot refine triangles; schemes on triangles: {ON_TRIANGLES}$"
    with pytest.raises(SchemeError, match=text):
        subdivide(octahedron(), name, levels)
    with pytest.raises(SchemeError, match=text):
        build_source(SourceSettings(levels=levels), name)


@over("name", TRIANGLE_SCHEMES)
@over("levels", [0, 1])
def test_a_scheme_on_triangles_on_curves(name, levels):
    text = f"^a scheme on triangles cannot refine curves; schemes on curves: {ON_CURVES}$"
    with pytest.raises(SchemeError, match=text):
        subdivide(single(4, closed=True), name, levels)


@by_curve_scheme
def test_curves_that_branch(name):
    cross = Curves(np.eye(3), [0, 1, 1, 2], [2, 2], [False, False])
    with pytest.raises(MeshError, match="subdivision needs curves that do not branch: vertex 1 is in the chains twice"):
        subdivide(cross, name)


@by_curve_scheme
@over("levels", [-1, -5])
def test_negative_levels(name, levels):
    with pytest.raises(SchemeError, match=f"levels={levels} is not allowed: expected 0 or more"):
        subdivide(single(3, closed=True), name, levels)


@by_curve_scheme
@over("count", [0, 1])
def test_no_curves_at_all_are_refined_to_none(name, count):
    fine = subdivide(Curves(np.ones((count, 3)), [], [], []), name, 2)
    assert np.array_equal(fine.verts, np.ones((count, 3)))
    assert fine.num_segments == 0


def test_level_0_changes_nothing():
    curves = single(4, closed=False)
    same = subdivide(curves, "four-point", 0)
    assert np.array_equal(same.verts, curves.verts)
    assert np.array_equal(same.corners, curves.corners)


@over(
    ("spec", "parameters", "message"),
    [
        ("four-point", {"tension": 0.2}, "tension=0.2 is not allowed: expected a number from 0 to 0.154508"),
        ("four-point", {"tension": -0.1}, "tension=-0.1 is not allowed"),
        ("four-point", {"tension": float("nan")}, "tension=nan is not allowed"),
        ("four-point", {"alpha": 0.5}, "scheme 'four-point' has no parameter 'alpha': allowed: tension"),
        ("cubic-bspline", {"tension": 0.1}, "has no parameter 'tension': it takes none"),
        ("interp-bspline", {"alpha": 1.5}, "alpha=1.5 is not allowed: expected a number from 0 to 1"),
        ("four-pont", {}, "'four-pont' is not a scheme: did you mean 'four-point'"),
        (
            "cubic-bspline",
            {"alpha": np.full(3, 0.5)},
            "this scheme has no parameter alpha; interp-loop",
        ),
        ("interp-bspline", {"alpha": np.full(4, 0.5)}, None),
        ("interp-bspline", {"alpha": np.array([0, 0.5, 2])}, "alpha is not allowed: all its values must lie from 0"),
    ],
)
def test_parameters(spec, parameters, message):
    with pytest.raises((SchemeError, MeshError), match=message or "expected one value for each of 3 vertices"):
        subdivide(single(3, closed=True), spec, **parameters)


@over("inserted", [(), LINEAR.inserted * 3])
def test_masks_that_divide_segments_otherwise(inserted):
    with pytest.raises(SchemeError, match=f"a curve mask of {len(inserted)} inserted vertices; 1 or 2 are allowed"):
        CurveScheme(CurveMask(KEPT, inserted))


@over(
    ("vert", "inserted", "message"),
    [
        ({-2: Fraction(1)}, LINEAR.inserted, "offset -2; -1 to 1 are allowed"),
        ({2: Fraction(1)}, LINEAR.inserted, "offset 2; -1 to 1 are allowed"),
        (KEPT, ({3: Fraction(1)},), "offset 3; -1 to 2 are allowed"),
        (KEPT, ({-2: Fraction(1)},), "offset -2; -1 to 2 are allowed"),
    ],
)
def test_masks_that_reach_too_far(vert, inserted, message):
    with pytest.raises(SchemeError, match=f"a curve mask has a weight at {message}"):
        CurveMask(vert, inserted)


def test_a_scheme_of_ones_own():
    own = CurveScheme(four_point(Fraction(1, 10)))
    assert own.split is CurveSplit.BISECT
    curves = single(6, closed=True)
    np.testing.assert_allclose(subdivide(curves, own, 3).verts, subdivide(curves, "four-point:tension=0.1", 3).verts)


def test_experiments_refuse_schemes_on_curves():
    for name in CURVE_SCHEMES:
        text = f"schemes.1.: {name} refines curves, and experiments fit surfaces; allowed: {ON_TRIANGLES}"
        with pytest.raises(ConfigError, match=text):
            load_experiment("quickstart", [f"schemes=[loop, {name}]"])


def test_the_table_lists_curves_last():
    assert list(SCHEMES)[-len(CURVE_SCHEMES) :] == list(CURVE_SCHEMES)
    for name in SCHEMES:
        assert (SCHEMES[name].domain == "curves") == isinstance(resolve(name), CurveScheme)
        assert domain_of(resolve(name)) == SCHEMES[name].domain


@by_curve_scheme
def test_kind_in_the_table_is_what_the_scheme_does(name):
    curves = single(5, closed=True)
    kept = refine(Chains.of(curves), resolve(name), 2).matrix.toarray()[:5]
    assert np.array_equal(kept, np.eye(5)) == (CURVE_SCHEMES[name].kind == "interpolatory")


def test_refinement_carries_any_attribute_and_gradients():
    import torch

    refinement = refine(Chains.of(single(5, closed=False)), resolve("four-point"), 2)
    values = torch.arange(5.0, dtype=torch.float64, requires_grad=True)
    fine = refinement(values)
    np.testing.assert_allclose(fine.detach().numpy(), refinement.matrix @ np.arange(5.0), rtol=0, atol=1e-14)
    fine.sum().backward()
    np.testing.assert_allclose(values.grad.numpy(), refinement.matrix.sum(axis=0), rtol=0, atol=1e-14)
    with pytest.raises(MeshError, match="found 4 values; expected one for each of 5 coarse vertices"):
        refinement(np.zeros(4))


def test_public_names():
    assert meshfit.Curves is Curves
    assert isinstance(refine(Topology.of(octahedron()), resolve("loop")), meshfit.Refinement)
    assert isinstance(refine(Chains.of(single(3, closed=True)), resolve("four-point")), meshfit.CurveRefinement)
