"""A surface between two changes of its connectivity, with what is known of it."""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from meshfit.remeshing.connectivity import Edges
from meshfit.remeshing.triangle_geometry import area_vectors, length_of, turned_over, unit

# What a face on the sphere has to exceed, as `turned_over` has it; from a needle, there is no way to a better map.
NEEDLE = 0.02


@dataclass(frozen=True, eq=False)
class RemeshState:
    """An oriented manifold, with or without boundary, and the edge lengths wanted of it.

    Attributes:
        verts: (V, 3) positions.
        faces: (F, 3) vertex indices, counter-clockwise seen from outside.
        lengths: (V,) the edge length wanted at each vertex, in the unit of the verts.
        known: the edges of these faces, if they are known already.
        on_sphere: (V, 3) where each vertex is on the unit sphere, if the surface has a map to it that turns no face
            over; a change that would make it turn one over counts as one that flips it.
    """

    verts: Float[Tensor, "V 3"]
    faces: Int64[Tensor, "F 3"]
    lengths: Float[Tensor, " V"]
    known: Edges | None = None
    on_sphere: Float[Tensor, "V 3"] | None = None

    @cached_property
    def edges(self) -> Edges:
        """The edges of the faces."""
        return self.known or Edges.of(self.faces, len(self.verts))

    @cached_property
    def normals(self) -> Float[Tensor, "F 3"]:
        """Unit normals, 0 for faces without area."""
        return unit(area_vectors(self.verts, self.faces))

    @cached_property
    def flipped(self) -> Bool[Tensor, " F"]:
        """Which faces look away from their surroundings, or are turned over on the sphere or nearly so."""
        flipped = self.edges.flipped(self.normals)
        return flipped if self.on_sphere is None else flipped | turned_over(self.on_sphere, self.faces, NEEDLE)

    @cached_property
    def wanted(self) -> Float[Tensor, " E"]:
        """The length wanted of each edge, the mean of its ends."""
        lengths, edges = self.lengths, self.edges
        return (lengths.index_select(0, edges.head) + lengths.index_select(0, edges.tail)) / 2

    @cached_property
    def ratio(self) -> Float[Tensor, " E"]:
        """The length of each edge over the length wanted."""
        edges = self.edges
        return length_of(self.verts.index_select(0, edges.head) - self.verts.index_select(0, edges.tail)) / self.wanted

    def compact(self) -> "RemeshState":
        """The same without the verts that no face uses; the others stay in their order."""
        used = self.edges.valence > 0
        if bool(used.all()):
            return self
        number, which = used.cumsum(0) - 1, used.nonzero()[:, 0]
        return RemeshState(
            self.verts.index_select(0, which),
            number.index_select(0, self.faces.reshape(-1)).view(-1, 3),
            self.lengths.index_select(0, which),
            self.edges.renumbered(number, len(which)),
            None if self.on_sphere is None else self.on_sphere.index_select(0, which),
        )

    def around_flipped(self, among: Bool[Tensor, " F"]) -> Bool[Tensor, " V"]:
        """The verts of flipped faces, of some that count, and of the neighbours of these.

        Those that are turned over on the sphere count always: what was nearly so before must not come to be.
        """
        flipped = self.flipped & among
        if self.on_sphere is not None:
            flipped |= turned_over(self.on_sphere, self.faces)
        return around(self.edges, self.faces, flipped)


def around(edges: Edges, faces: Int64[Tensor, "F 3"], mask: Bool[Tensor, " F"]) -> Bool[Tensor, " V"]:
    """The verts of some faces and of their neighbours."""
    found = torch.zeros(edges.num_verts, dtype=torch.bool, device=faces.device)
    which = mask.nonzero()[:, 0]
    if len(which):
        sides = edges.of_side.index_select(0, which).reshape(-1)
        found[faces.index_select(0, which).reshape(-1)] = True
        found[edges.left_apex.index_select(0, sides)] = True
        found[edges.right_apex.index_select(0, sides)] = True
    return found
