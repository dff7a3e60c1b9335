"""The state of remeshing: a surface between two changes of its connectivity."""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from meshfit.remeshing.connectivity import Edges
from meshfit.remeshing.triangle_geometry import double_area_vectors, length_of, turned_over, unit

# Least shape of a face on the sphere, as in `turned_over`; sphere maps with needles cannot be improved.
NEEDLE = 0.02


@dataclass(frozen=True, eq=False)
class RemeshState:
    """An oriented manifold, with or without boundary, and its target edge lengths.

    Attributes:
        verts: (V, 3) positions.
        faces: (F, 3) vertex indices, counter-clockwise seen from outside.
        lengths: (V,) target edge length at each vertex, in the unit of the vertices.
        known: the edges of the faces, if known.
        on_sphere: (V, 3) places on the unit sphere, if the surface has a sphere map. Faces must not be turned over on
            the sphere, just as they must not flip.
    """

    verts: Float[Tensor, "V 3"]
    faces: Int64[Tensor, "F 3"]
    lengths: Float[Tensor, " V"]
    known: Edges | None = None
    on_sphere: Float[Tensor, "V 3"] | None = None

    @cached_property
    def edges(self) -> Edges:
        """Edges of the faces."""
        return self.known or Edges.of(self.faces, len(self.verts))

    @cached_property
    def normals(self) -> Float[Tensor, "F 3"]:
        """Unit normals of the faces; 0 without area."""
        return unit(double_area_vectors(self.verts, self.faces))

    @cached_property
    def flipped(self) -> Bool[Tensor, " F"]:
        """Whether each face is flipped, or turned over on the sphere or nearly so."""
        flipped = self.edges.flipped(self.normals)
        return flipped if self.on_sphere is None else flipped | turned_over(self.on_sphere, self.faces, NEEDLE)

    @cached_property
    def target_lengths(self) -> Float[Tensor, " E"]:
        """Target length of each edge: the mean of its ends."""
        lengths, edges = self.lengths, self.edges
        return (lengths.index_select(0, edges.head) + lengths.index_select(0, edges.tail)) / 2

    @cached_property
    def ratio(self) -> Float[Tensor, " E"]:
        """Length of each edge over its target length."""
        head, tail = (self.verts.index_select(0, ends) for ends in (self.edges.head, self.edges.tail))
        return length_of(head - tail) / self.target_lengths

    def compact(self) -> "RemeshState":
        """Remove unused vertices; the others keep their order."""
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
        """Return the vertices of the flipped faces among some, and of their neighbours.

        Faces turned over on the sphere always count: those that nearly were before must not become so.
        """
        flipped = self.flipped & among
        if self.on_sphere is not None:
            flipped |= turned_over(self.on_sphere, self.faces)
        return around(self.edges, self.faces, flipped)


def around(edges: Edges, faces: Int64[Tensor, "F 3"], mask: Bool[Tensor, " F"]) -> Bool[Tensor, " V"]:
    """Return the vertices of some faces and of their neighbours."""
    verts = torch.zeros(edges.num_verts, dtype=torch.bool, device=faces.device)
    which = mask.nonzero()[:, 0]
    if len(which):
        sides = edges.of_side.index_select(0, which).reshape(-1)
        verts[faces.index_select(0, which).reshape(-1)] = True
        verts[edges.left_apex.index_select(0, sides)] = True
        verts[edges.right_apex.index_select(0, sides)] = True
    return verts
