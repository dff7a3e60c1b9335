"""Edge table of a triangle mesh, in torch; rebuilt after each change of the faces."""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from meshfit.mesh.topology import NONE
from meshfit.remeshing.triangle_geometry import dot


@dataclass(frozen=True, eq=False)
class Edges:
    """The edges of an oriented manifold, sorted by key.

    Half-edge 3 f + k goes along face f from its corner k to its corner k + 1 (mod 3). An edge has the direction of its
    first half-edge: its left face is (tail, head, left apex), its right face (head, tail, right apex).

    Attributes:
        num_verts: V; unused vertices are allowed.
        keys: (E,) smaller end times V plus larger end, ascending.
        tail, head: (E,) ends.
        left, right: (E,) half-edge on each side; `NONE` on the right of a boundary edge.
        left_apex, right_apex: (E,) opposite vertices; on the right of a boundary edge, the left apex again.
        order: (3 F,) half-edges, sorted by edge.
    """

    num_verts: int
    keys: Int64[Tensor, " E"]
    tail: Int64[Tensor, " E"]
    head: Int64[Tensor, " E"]
    left: Int64[Tensor, " E"]
    right: Int64[Tensor, " E"]
    left_apex: Int64[Tensor, " E"]
    right_apex: Int64[Tensor, " E"]
    order: Int64[Tensor, " H"]

    @classmethod
    def of(cls, faces: Int64[Tensor, "F 3"], num_verts: int) -> "Edges":
        """Return the edges of some faces, at most two per edge."""
        tails, heads, apexes = (faces.roll(-k, 1).reshape(-1) for k in range(3))
        keys, order = pair_keys(tails, heads, num_verts).sort(stable=True)
        first = torch.ones_like(keys, dtype=torch.bool)
        first[1:] = keys[1:] != keys[:-1]
        start = first.nonzero()[:, 0]
        double = start.diff(append=start.new_tensor([len(keys)])) == 2
        left, across = order.index_select(0, start), order.index_select(0, start + double)
        return cls(
            num_verts=num_verts,
            keys=keys.index_select(0, start),
            tail=tails.index_select(0, left),
            head=heads.index_select(0, left),
            left=left,
            right=across.masked_fill(~double, NONE),
            left_apex=apexes.index_select(0, left),
            right_apex=apexes.index_select(0, across),
            order=order,
        )

    def renumbered(self, number: Int64[Tensor, " V"], num_verts: int) -> "Edges":
        """Return the same edges after an order-preserving renumbering of the vertices."""
        tail, head, left_apex, right_apex = (
            number.index_select(0, verts) for verts in (self.tail, self.head, self.left_apex, self.right_apex)
        )
        keys = pair_keys(tail, head, num_verts)
        return Edges(num_verts, keys, tail, head, self.left, self.right, left_apex, right_apex, self.order)

    @cached_property
    def of_side(self) -> Int64[Tensor, "F 3"]:
        """Edge of each half-edge."""
        number = torch.arange(len(self.keys), device=self.keys.device).repeat_interleave(1 + self.inner.long())
        return torch.empty_like(self.order).scatter_(0, self.order, number).view(-1, 3)

    @cached_property
    def inner(self) -> Bool[Tensor, " E"]:
        """Whether each edge has two faces."""
        return self.right >= 0

    @cached_property
    def outer(self) -> Int64[Tensor, " B"]:
        """Indices of the boundary edges."""
        return (~self.inner).nonzero()[:, 0]

    @cached_property
    def valence(self) -> Int64[Tensor, " V"]:
        """Number of edges at each vertex."""
        return torch.bincount(torch.cat([self.tail, self.head]), minlength=self.num_verts)

    @cached_property
    def on_boundary(self) -> Bool[Tensor, " V"]:
        """Whether each vertex is on a boundary edge."""
        mask = torch.zeros(self.num_verts, dtype=torch.bool, device=self.keys.device)
        mask[self.tail.index_select(0, self.outer)] = True
        mask[self.head.index_select(0, self.outer)] = True
        return mask

    @cached_property
    def least_valence(self) -> Int64[Tensor, " V"]:
        """Least valence that a change may leave: 4, or 3 on the boundary."""
        return 4 - self.on_boundary.long()

    @cached_property
    def scrambled(self) -> Int64[Tensor, " E"]:
        """The number of each edge below 20 pseudo-random bits, to break ties without a preferred direction.

        If ties are broken by number, a row of equal edges changes only one edge at a time.
        """
        number = torch.arange(len(self.keys), device=self.keys.device)
        bits = (number * 0x9E3779B1) & 0xFFFFFFFF
        bits = ((bits ^ (bits >> 15)) * 0x85EBCA77) & 0xFFFFFFFF
        return (((bits ^ (bits >> 13)) & 0xFFFFF) << 32) | number

    def have(self, a: Int64[Tensor, " N"], b: Int64[Tensor, " N"]) -> Bool[Tensor, " N"]:
        """Return which pairs of vertices have an edge."""
        return contained(pair_keys(a, b, self.num_verts), self.keys)

    def flipped(self, normals: Float[Tensor, "F 3"]) -> Bool[Tensor, " F"]:
        """Return which faces are flipped: n · (n₁ + n₂ + n₃) < 0, with the normals of their neighbours."""
        inner = self.inner.nonzero()[:, 0]
        left, right = self.left.index_select(0, inner) // 3, self.right.index_select(0, inner) // 3
        cosines = dot(normals.index_select(0, left), normals.index_select(0, right))
        return torch.zeros_like(normals[:, 0]).index_add_(0, left, cosines).index_add_(0, right, cosines) < 0


def pair_keys(a: Int64[Tensor, " N"], b: Int64[Tensor, " N"], num_verts: int) -> Int64[Tensor, " N"]:
    """Return one number per unordered pair of vertices."""
    return torch.minimum(a, b) * num_verts + torch.maximum(a, b)


def contained(keys: Int64[Tensor, " N"], ordered: Int64[Tensor, " M"]) -> Bool[Tensor, " N"]:
    """Return which keys are among others, which are sorted."""
    if not len(ordered):
        return torch.zeros_like(keys, dtype=torch.bool)
    place = torch.searchsorted(ordered, keys).clamp_max(len(ordered) - 1)
    return ordered.index_select(0, place) == keys
