"""Steps that leave the surface sound: no face crosses another, flips over, or shrinks to a needle."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.loss.sparse import Sparse
from meshfit.remeshing.self_intersections import intersecting_faces

# The least double area of a face, in squares of its longest edge.
_NEEDLE = 0.02
_TRIES, _HALVINGS = 12, 4
# What verts of a control mesh have to do with a place of the surface, at least, to be held back for it.
_FELT = 0.05
_UNTANGLINGS, _PATIENCE = 30, 8


def unsound_faces(shape: Shape, among: Bool[Tensor, " F"] | None = None) -> Bool[Tensor, " F"]:
    """Which faces cross others, are flipped, or are needles.

    A face is flipped where n · (n₁ + n₂ + n₃) < 0, with the normals of its neighbours.

    Args:
        shape: the surface.
        among: look only for crossings of these faces.
    """
    connectivity = shape.connectivity
    longest = shape.edge_lengths[connectivity.edges.of_side].amax(1)
    bad = connectivity.edges.flipped(shape.normals) | ~(shape.double_area >= _NEEDLE * longest.square())
    return bad | intersecting_faces(shape.verts, connectivity.faces, among=among)


def limited_step(
    connectivity: Connectivity,
    start: Float[Tensor, "C 3"],
    end: Float[Tensor, "C 3"],
    control: tuple[Connectivity, Sparse] | None = None,
) -> tuple[Float[Tensor, "C 3"], Bool[Tensor, " C"]]:
    """Go from one place to another as far as no face becomes unsound that was not so before.

    The step is halved at the verts of such faces, and then refused, in growing surroundings. In the worst case nothing
    moves, so that a surface which was sound stays so.

    Args:
        connectivity: of the surface.
        start: where its verts are, or those of its control mesh.
        end: where they are to go.
        control: the control mesh's connectivity, and what takes its verts to those of the surface, if it has one.

    Returns:
        Where they go, and which were held back.
    """

    def surface(verts: Tensor) -> Shape:
        return Shape(connectivity, verts if control is None else control[1] @ verts)

    moving = connectivity if control is None else control[0]
    step, share = end - start, torch.ones_like(start[:, :1])
    held = torch.zeros(len(start), dtype=torch.bool, device=start.device)
    before: Tensor | None = None
    changed: Tensor | None = None
    for attempt in range(_TRIES):
        verts = start + share * step
        bad = unsound_faces(surface(verts), changed)
        if bool(bad.any()) and before is None:
            before = unsound_faces(surface(start))
        if before is not None:
            bad &= ~before
        if not bool(bad.any()):
            return verts, held
        near = connectivity.verts_of(bad)
        if control is not None:
            near = (control[1].T @ near[:, None].expand(-1, 3).to(start))[:, 0] > _FELT
        for _ in range(min(attempt // 2, _HALVINGS)):
            near = moving.grown(near)
        held |= near
        share = torch.where(near[:, None], share / 2 if attempt < _HALVINGS else 0, share)
        # Faces that cross are among those that move next, so that no others can come to cross.
        changed = near[connectivity.faces].any(1) if control is None else None
    return start, torch.ones_like(held)


def untangled(
    connectivity: Connectivity, verts: Float[Tensor, "V 3"], most: int = _UNTANGLINGS
) -> tuple[Float[Tensor, "V 3"], int]:
    """Smooth unsound faces, then growing surroundings of them, until there are none, or there is no progress.

    Returns:
        The places of the verts with the fewest unsound faces, and how many those are.
    """
    best, fewest, last = verts, len(connectivity.faces) + 1, 0
    for attempt in range(most):
        bad = unsound_faces(Shape(connectivity, verts))
        count = int(bad.sum())
        if count < fewest:
            best, fewest, last = verts, count, attempt
        if not count or attempt - last > _PATIENCE:
            break
        near = connectivity.verts_of(bad)
        for _ in range(attempt // 2):
            near = connectivity.grown(near)
        verts = torch.where(near[:, None], verts - (connectivity.umbrella @ verts) / 2, verts)
    return best, fewest
