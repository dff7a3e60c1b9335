"""Remeshing: new connectivity for a moving surface, with edges of the lengths that are wanted."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from meshfit.errors import MeshError
from meshfit.remeshing.collapse import collapse
from meshfit.remeshing.flip import flip
from meshfit.remeshing.relax import relax
from meshfit.remeshing.sizing import num_verts_for
from meshfit.remeshing.split import split
from meshfit.remeshing.state import RemeshState

_LONG, _SHORT = 4 / 3, 4 / 5
# Beyond this share of the number of verts expected, further edges are split or collapsed to make up for it.
_TOLERANCE = 0.03
# For these: which edges may be split, which collapsed, and how long an edge may become by it.
_ABOVE, _BELOW, _LOOSE = 1.05, 1.0, 1.5


@torch.no_grad()
def remesh(
    verts: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"], lengths: Float[Tensor, " V"], *, rounds: int = 5
) -> tuple[Float[Tensor, "W 3"], Int64[Tensor, "G 3"], Float[Tensor, " W"]]:
    """Give a surface edges of the lengths wanted, and triangles near equilateral, without moving it much.

    Each round splits edges longer than 4/3 of the length wanted, collapses those shorter than 4/5, turns edges towards
    valence 6, and slides verts within the surface (Botsch and Kobbelt, A remeshing approach to multiresolution
    modeling, 2004), to a length that differs from place to place (Dunyach, Vanderhaeghe, Barthe and Botsch, Adaptive
    remeshing for real-time mesh deformation, 2013), with operations that do not touch each other done at once
    (compare Palfinger, Continuous remeshing for inverse rendering, 2022). Where all edges are alike, none or all may
    lie between 4/5 and 4/3, so that from the second round on the number of verts is led to `num_verts_for`.

    The topology is kept: the surface stays a manifold with the same pieces, Euler number and boundary loops, and no
    face comes to look away from its surroundings. Verts on the boundary do not leave it, and bends of it stay. Nothing
    is projected back; collapses keep the volume, so that it changes by less than 0.5 % with lengths up to 1/50 of the
    diagonal, more where parts are thinner than two edges. On the CPU the result is the same, to the bit, each time.

    Args:
        verts: (V, 3) positions, float64 or float32.
        faces: (F, 3) int64, an oriented manifold, closed or with boundary.
        lengths: (V,) the length wanted at each vertex, in the unit of the verts. A field that changes by more than
            some 30 % from a vertex to the next leaves poor triangles: see `limited`.
        rounds: how many; 3 do where lengths are much as they were.

    Returns:
        Verts, faces and lengths wanted, of as many verts as there are then; verts that no face uses are left out.

    Raises:
        MeshError: no faces, an edge with more than two, or a length or position that is no sound number.
    """
    surface = remeshed(RemeshState(verts, faces, lengths), rounds)
    return surface.verts, surface.faces, surface.lengths


def remeshed(surface: RemeshState, rounds: int) -> RemeshState:
    """What `remesh` does, to a surface that may have a map to the sphere; that stays one to one.

    Raises:
        MeshError: as `remesh`.
    """
    expected = num_verts_for(_checked(surface).verts, surface.faces, surface.lengths)
    surface = surface.compact()
    for done in range(rounds):
        surface = collapse(split(surface, _LONG), _SHORT, _LONG)
        missing = round(expected) - len(surface.verts)
        if done >= 1 and missing > _TOLERANCE * expected:
            surface = split(surface, _ABOVE, missing)
        # After two rounds verts go of themselves: what is too many before is not what will be.
        if done >= 2 and missing < -_TOLERANCE * expected:
            surface = collapse(surface, _BELOW, _LOOSE, -missing)
        surface = relax(flip(surface))
    return surface


def _checked(surface: RemeshState) -> RemeshState:
    if not len(surface.faces):
        raise MeshError("remeshing needs faces, and there are none")
    for values, least, what in ((surface.verts, -torch.inf, "positions"), (surface.lengths, 0, "positive lengths")):
        if not bool((torch.isfinite(values) & (values > least)).all()):
            raise MeshError(f"remeshing needs {what} that are finite")
    if len(surface.edges.order) != len(surface.edges.keys) + int(surface.edges.inner.sum()):
        raise MeshError("remeshing needs a manifold mesh: an edge has more than 2 faces")
    return surface
