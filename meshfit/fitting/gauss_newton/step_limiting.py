"""Step limiting: steps are shortened where faces would intersect, flip, or become needles."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from meshfit.fitting.gauss_newton.equations import ControlledSurface
from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.remeshing.self_intersections import intersecting_faces
from meshfit.remeshing.triangle_geometry import corners_of, normal_and_sine
from meshfit.units import count_text

# Angle in degrees below which a face is reported.
_LEAST_ANGLE = 1.0
# Least double area of a face, in squares of its longest edge.
_NEEDLE = 0.02
_ATTEMPTS, _HALVINGS = 12, 4
# Least weight of a control vertex at a place of the surface to be held back for it.
_LEAST_WEIGHT = 0.05
_UNTANGLINGS, _PATIENCE = 30, 8


def unsound_faces(shape: Shape, among: Bool[Tensor, " F"] | None = None) -> Bool[Tensor, " F"]:
    """Return which faces intersect others, are flipped, or are needles; other pieces count unless they may cross.

    A face is flipped if n · (n₁ + n₂ + n₃) < 0, with the normals of its neighbours.

    Args:
        shape: the surface.
        among: look for intersections of these faces only.
    """
    connectivity = shape.connectivity
    longest = shape.edge_lengths[connectivity.edges.of_side].amax(1)
    bad = connectivity.edges.flipped(shape.normals) | ~(shape.double_area >= _NEEDLE * longest.square())
    return bad | intersecting_faces(connectivity.apart(shape.verts), connectivity.faces, among=among)


def num_crossing(shape: Shape) -> int:
    """Return how many faces cross others; those of other pieces count unless they may cross."""
    connectivity = shape.connectivity
    return int(intersecting_faces(connectivity.apart(shape.verts.double()), connectivity.faces).sum())


def faults_of(shape: Shape) -> list[str]:
    """Return in words how many faces cross others or have a tiny angle; other pieces count unless they may cross."""
    _, sines = normal_and_sine(*corners_of(shape.verts.double(), shape.connectivity.faces))
    crossing = num_crossing(shape)
    needles = int((sines < math.sin(math.radians(_LEAST_ANGLE))).sum())
    texts = [f"self-intersecting: {count_text(crossing, 'face')}"] if crossing else []
    return texts + ([f"thin faces: {count_text(needles, 'face')} with an angle below 1 degree"] if needles else [])


def limit_step(
    connectivity: Connectivity,
    start: Float[Tensor, "V 3"],
    end: Float[Tensor, "V 3"],
    controlled: ControlledSurface | None = None,
) -> tuple[Float[Tensor, "V 3"], Bool[Tensor, " V"]]:
    """Move vertices as far towards their ends as no sound face becomes unsound.

    The step is halved at the vertices of newly unsound faces, then refused there, in growing neighbourhoods. In the
    worst case nothing moves, so that a sound surface stays sound.

    Args:
        connectivity: the mesh that moves.
        start: (V, 3) its current positions.
        end: (V, 3) where they should go.
        controlled: the surface that has to stay sound, if the mesh is its control mesh.

    Returns:
        The new positions, and which vertices were held back.
    """
    surface = connectivity if controlled is None else controlled.pattern.connectivity

    def shape(verts: Tensor) -> Shape:
        return Shape(surface, verts if controlled is None else controlled.operator @ verts)

    step, share = end - start, torch.ones_like(start[:, :1])
    held = torch.zeros(len(start), dtype=torch.bool, device=start.device)
    before: Tensor | None = None
    changed: Tensor | None = None
    for attempt in range(_ATTEMPTS):
        verts = start + share * step
        bad = unsound_faces(shape(verts), changed)
        if bool(bad.any()) and before is None:
            before = unsound_faces(shape(start))
        if before is not None:
            bad &= ~before
        if not bool(bad.any()):
            return verts, held
        near = surface.verts_of(bad)
        if controlled is not None:
            near = (controlled.operator.T @ near[:, None].expand(-1, 3).to(start))[:, 0] > _LEAST_WEIGHT
        for _ in range(min(attempt // 2, _HALVINGS)):
            near = connectivity.grown(near)
        held |= near
        share = torch.where(near[:, None], share / 2 if attempt < _HALVINGS else 0, share)
        # Faces that intersect now will move next, so that no other faces can come to intersect.
        changed = near[surface.faces].any(1) if controlled is None else None
    return start, torch.ones_like(held)


def untangle(
    connectivity: Connectivity, verts: Float[Tensor, "V 3"], most: int = _UNTANGLINGS
) -> tuple[Float[Tensor, "V 3"], int]:
    """Smooth unsound faces, in growing neighbourhoods, until there are none or no progress is made.

    Returns:
        The positions with the fewest unsound faces, and their number.
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
