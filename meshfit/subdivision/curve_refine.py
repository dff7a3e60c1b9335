"""Refinement of curves: some levels of a scheme on their chains."""

from functools import partial

from meshfit.mesh.curves import Chains, require_chains
from meshfit.subdivision.curve_assemble import assemble_curves, vertex_attribute_carry
from meshfit.subdivision.curve_scheme import CurveScheme
from meshfit.subdivision.push_back import with_carried_alpha
from meshfit.subdivision.refinement import CurveRefinement


def refine_chains(chains: Chains, scheme: CurveScheme, levels: int) -> CurveRefinement:
    """Lay down `levels` levels of a scheme, 0 or more.

    Raises:
        MeshError: the chains branch, or are none; a vertex or chain at fault is named.
    """
    if levels:
        require_chains(chains, "subdivision")
    num_coarse, operators = chains.num_verts, []
    for _ in range(levels):
        operators.append(assemble_curves(chains, scheme))
        scheme = with_carried_alpha(scheme, partial(vertex_attribute_carry, chains, scheme))
        chains = chains.split(len(scheme.mask.inserted))
    return CurveRefinement(num_coarse, tuple(operators), chains)
