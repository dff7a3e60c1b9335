"""Edge splits: new vertices at the midpoints of long edges, all at once."""

import torch
from jaxtyping import Bool
from torch import Tensor

from meshfit.remeshing.state import RemeshState
from meshfit.remeshing.triangle_geometry import length_of, unit


def split(surface: RemeshState, long: float, most: int | None = None) -> RemeshState:
    """Split the edges that are longer than `long` times their target length; the surface does not move.

    Faces with one, two or three such edges become two, three or four. Of the two ways to cut in three, the one with
    the shorter new edge is taken.

    Args:
        surface: the surface.
        long: longest edge that is kept, relative to its target length.
        most: largest number of splits, of the relatively longest edges.
    """
    edges, verts, lengths = surface.edges, surface.verts, surface.lengths
    which = (surface.ratio > long).nonzero()[:, 0]
    if most is not None and len(which) > most:
        # Ranks of 5 % with pseudo-random ties, so that nearly equal edges are taken from everywhere.
        steps = 1000 - (surface.ratio.index_select(0, which) * 20).long().clamp_max(1000)
        rank = (steps << 52) | edges.scrambled.index_select(0, which)
        which = which.index_select(0, rank.sort().indices[:most])
    if not len(which):
        return surface
    tail, head = edges.tail.index_select(0, which), edges.head.index_select(0, which)
    verts = torch.cat([verts, (verts.index_select(0, tail) + verts.index_select(0, head)) / 2])
    number = torch.full_like(edges.keys, -1)
    number[which] = torch.arange(len(lengths), len(verts), device=verts.device)
    middles = number.index_select(0, edges.of_side.reshape(-1)).view(-1, 3)
    lengths = torch.cat([lengths, surface.target_lengths.index_select(0, which)])
    on_sphere = surface.on_sphere
    if on_sphere is not None:
        on_sphere = torch.cat([on_sphere, unit(on_sphere.index_select(0, tail) + on_sphere.index_select(0, head))])
    return RemeshState(verts, _cut(verts, surface.faces, middles), lengths, on_sphere=on_sphere)


def _cut(verts: Tensor, faces: Tensor, middles: Tensor) -> Tensor:
    """Cut faces at the new vertices on their sides; -1 for none."""
    count = (middles >= 0).sum(1)
    single, double, triple = (_rotated(faces, middles, count == cuts, cuts) for cuts in (1, 2, 3))
    parts = [faces[count == 0]]
    a, b, c, m, _, _ = single
    parts += _rows((a, m, c), (m, b, c))
    a, b, c, m, n, _ = double
    an, mc = (length_of(verts.index_select(0, p) - verts.index_select(0, q)) for p, q in ((a, n), (m, c)))
    along = an <= mc
    parts += _rows((m, b, n), (a, m, torch.where(along, n, c)), (torch.where(along, a, m), n, c))
    a, b, c, m, n, p = triple
    parts += _rows((a, m, p), (m, b, n), (p, n, c), (m, n, p))
    return torch.cat(parts)


def _rotated(faces: Tensor, middles: Tensor, mask: Bool[Tensor, " F"], cuts: int) -> tuple[Tensor, ...]:
    """Return corners and middles of some faces, rotated so that the cut sides come first."""
    which = mask.nonzero()[:, 0]
    corners, middles = faces.index_select(0, which), middles.index_select(0, which)
    cut = (middles >= 0).int()
    start = cut.argmax(1) if cuts == 1 else cut.argmin(1) + 1
    turn = (start[:, None] + torch.arange(3, device=faces.device)) % 3
    return (*corners.gather(1, turn).unbind(1), *middles.gather(1, turn).unbind(1))


def _rows(*faces: tuple[Tensor, Tensor, Tensor]) -> list[Tensor]:
    return [torch.stack(face, 1) for face in faces]
