"""Isotropic remeshing towards target edge lengths that vary over the surface."""

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
# Deviation from the predicted number of vertices from which further edges are split or collapsed.
_TOLERANCE = 0.03
# Of those: edges that may be split, edges that may be collapsed, and the longest edge that may result.
_ABOVE, _BELOW, _LOOSE = 1.05, 1.0, 1.5


@torch.no_grad()
def remesh(
    verts: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"], lengths: Float[Tensor, " V"], *, rounds: int = 5
) -> tuple[Float[Tensor, "W 3"], Int64[Tensor, "G 3"], Float[Tensor, " W"]]:
    """Remesh a surface to target edge lengths and nearly equilateral triangles, without moving it much.

    Each round splits edges longer than 4/3 of their target, collapses those shorter than 4/5, flips edges towards
    valence 6, and slides vertices within the surface (Botsch and Kobbelt, A remeshing approach to multiresolution
    modeling, 2004), with targets that vary (Dunyach, Vanderhaeghe, Barthe and Botsch, Adaptive remeshing for real-time
    mesh deformation, 2013), and all independent operations at once (compare Palfinger, Continuous remeshing for
    inverse rendering, 2022). Where all edges are equal, all or none may be between 4/5 and 4/3; therefore, from the
    second round on, the number of vertices is steered towards `num_verts_for`.

    The topology is kept: the surface stays a manifold with the same components, Euler number and boundary loops, and
    no face becomes flipped. Boundary vertices stay on the boundary, and its bends stay. Nothing is projected back;
    collapses keep the volume, which changes by less than 0.5 % for lengths up to 1/50 of the diagonal, and by more
    where parts are thinner than two edges. On the CPU the result is bit-identical every time.

    Args:
        verts: (V, 3) positions, float64 or float32.
        faces: (F, 3) int64, an oriented manifold, closed or with boundary.
        lengths: (V,) target length at each vertex, in the unit of the vertices. Changes of more than some 30 % between
            adjacent vertices give poor triangles; see `limit_gradation`.
        rounds: number of rounds; 3 are enough where the targets are close to the current lengths.

    Returns:
        Vertices, faces and target lengths, without unused vertices.

    Raises:
        MeshError: there are no faces, an edge has more than two, or a length or position is not finite or positive.
    """
    surface = remesh_state(RemeshState(verts, faces, lengths), rounds)
    return surface.verts, surface.faces, surface.lengths


def remesh_state(surface: RemeshState, rounds: int) -> RemeshState:
    """Remesh a state as `remesh` does; a sphere map stays one to one.

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
        # In the first two rounds surplus vertices go away without help.
        if done >= 2 and missing < -_TOLERANCE * expected:
            surface = collapse(surface, _BELOW, _LOOSE, -missing)
        surface = relax(flip(surface))
    return surface


def _checked(surface: RemeshState) -> RemeshState:
    if not len(surface.faces):
        raise MeshError("remeshing needs faces, but the mesh has none")
    for values, least, name in ((surface.verts, -torch.inf, "positions"), (surface.lengths, 0, "positive lengths")):
        if not bool((torch.isfinite(values) & (values > least)).all()):
            raise MeshError(f"remeshing needs {name} that are finite")
    if len(surface.edges.order) != len(surface.edges.keys) + int(surface.edges.inner.sum()):
        raise MeshError("remeshing needs a manifold mesh: an edge has more than 2 faces")
    return surface
