"""Guidance of a registration by what is known of the source: landmarks, weights, and parts that stay or are rigid."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.sparse import coo_array, csr_array

from meshfit.errors import MeshError, error_prefix
from meshfit.mesh.attributes import NO_ATTRIBUTES
from meshfit.mesh.geometry import nearest_rotations
from meshfit.mesh.interpolation import strongest_columns
from meshfit.mesh.landmarks import PlacedLandmarks
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.mirror_symmetry import MirrorPlane, mirror_partners, symmetrised
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import Indices, PolygonTopology, Topology
from meshfit.subdivision.refine import linear_scheme, refine, refined_mesh
from meshfit.subdivision.registry import Scheme, resolve
from meshfit.units import count_text

# Weights of subdivision below this are rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Guidance:
    """Prior knowledge of a source with V vertices.

    Attributes:
        landmarks: places on it, and where they belong on the target; those that are held out are only measured.
        weights: (V,) confidence in the data at each vertex, 0 or more; a vertex of weight 0 follows the others.
        fixed: (V,) vertices that stay where they are; the source is not moved to another pose then.
        rigid: (V,) label of the part that moves rigidly, for each vertex; 0 or less for those that are free.
        mirror: (V,) partner of each vertex, whose mirror image it stays; see `mirrored`.
    """

    landmarks: PlacedLandmarks | None = None
    weights: Float64[np.ndarray, " V"] | None = None
    fixed: Bool[np.ndarray, " V"] | None = None
    rigid: Int64[np.ndarray, " V"] | None = None
    mirror: Int64[np.ndarray, " V"] | None = None

    @property
    def used_landmarks(self) -> PlacedLandmarks | None:
        """The landmarks that a fit uses; None if there are none."""
        if self.landmarks is None or not self.landmarks.used.any():
            return None
        return self.landmarks.subset(self.landmarks.used)

    @property
    def steers(self) -> bool:
        """Whether it has an effect on a fit."""
        return self.used_landmarks is not None or any(
            values is not None for values in (self.weights, self.fixed, self.rigid, self.mirror)
        )

    def require_size(self, num_verts: int) -> None:
        """Check the values of vertices.

        Raises:
            MeshError: another number of them, or weights that are negative, not finite or all 0.
        """
        for name in ("weights", "fixed", "rigid"):
            values = getattr(self, name)
            if values is not None and values.shape != (num_verts,):
                expected = f"one value for each of the {num_verts:,} vertices of the source"
                raise MeshError(f"{name}: expected {expected}, got shape {values.shape}")
        if self.weights is not None and not (np.isfinite(self.weights).all() and self.weights.min() >= 0):
            raise MeshError("weights: expected finite numbers of 0 or more")
        if self.weights is not None and not self.weights.any():
            raise MeshError("weights: all are 0, so nothing pulls")
        if self.fixed is not None and self.fixed.all():
            raise MeshError("fixed: all vertices are, so nothing can move")

    def mirrored(self, mesh: Mesh | PolygonMesh) -> "Guidance":
        """Return it with the mirror symmetry of the mesh, which the result is to have, too.

        Raises:
            MeshError: the mesh is not symmetric, or what is fixed or rigid is not.
        """
        triangles = mesh.triangulated() if isinstance(mesh, PolygonMesh) else mesh
        with error_prefix("symmetric"):
            partner = mirror_partners(triangles)
            if self.fixed is not None and (odd := int((self.fixed != self.fixed[partner]).sum())):
                raise MeshError(f"fixed: {count_text(odd, 'vertex')} differ from their mirror images")
            if self.rigid is not None:
                _require_mirrored_parts(self.rigid, partner)
        return replace(self, mirror=partner)

    def refined(self, mesh: Mesh | PolygonMesh, scheme: str | Scheme, levels: int = 1) -> "Guidance":
        """Return the guidance of a mesh that was refined.

        A fine vertex is fixed, or in a rigid part, if all vertices that it depends on are.

        Args:
            mesh: to which the guidance belongs.
            scheme: of the refinement.
            levels: of the refinement.
        """
        if levels == 0:
            return self
        masks = resolve(scheme)
        topology = Topology.of(mesh) if isinstance(mesh, Mesh) else PolygonTopology.of(mesh)
        matrix = refine(topology, masks, levels).matrix
        landmarks = self.landmarks
        if landmarks is not None:
            flat = linear_scheme(masks) or masks
            fine = refined_mesh(mesh.with_attributes(NO_ATTRIBUTES), flat, refine(topology, flat, levels))
            surface = fine.triangulated() if isinstance(fine, PolygonMesh) else fine
            landmarks = landmarks.moved_to(surface, landmarks.points(mesh.verts))
        return Guidance(
            landmarks,
            None if self.weights is None else np.maximum(matrix @ self.weights, 0.0),
            None if self.fixed is None else ~_touched(matrix, ~self.fixed),
            None if self.rigid is None else _refined_labels(matrix, self.rigid),
        )


@dataclass(frozen=True, eq=False)
class HeldParts:
    """Vertices that stay, and parts that move rigidly.

    Attributes:
        rest: (V, 3) the vertices at rest.
        fixed: vertices that stay there.
        parts: vertices of each rigid part.
        mirror: (V,) partner of each vertex, whose mirror image it is; None for none.
    """

    rest: Verts
    fixed: Indices
    parts: Sequence[Indices]
    mirror: Indices | None = None

    @classmethod
    def of(cls, rest: Verts, guidance: Guidance | None) -> "HeldParts":
        """Return the parts of a guidance, for vertices at rest."""
        none = np.empty(0, dtype=np.int64)
        if guidance is None:
            return cls(rest, none, [])
        fixed = none if guidance.fixed is None else np.flatnonzero(guidance.fixed)
        labels = np.zeros(len(rest), dtype=np.int64) if guidance.rigid is None else guidance.rigid.copy()
        labels[fixed] = 0
        parts = [np.flatnonzero(labels == label) for label in np.unique(labels[labels > 0])]
        return cls(rest, fixed, parts, guidance.mirror)

    @property
    def mask(self) -> Bool[np.ndarray, " V"]:
        """Which vertices are fixed or in a rigid part."""
        mask = np.zeros(len(self.rest), dtype=bool)
        for verts in (self.fixed, *self.parts):
            mask[verts] = True
        return mask

    def __bool__(self) -> bool:
        """Return whether there is anything to hold."""
        return bool(len(self.fixed) or self.parts or self.mirror is not None)

    def applied(self, verts: Verts) -> Verts:
        """Return positions with fixed vertices at rest, and each part where a rigid motion brings it nearest to.

        With a mirror, they are made symmetric first: in the plane of the vertices at rest if some are fixed there.
        """
        if not self:
            return verts
        if self.mirror is not None:
            plane = MirrorPlane.between(self.rest, self.rest[self.mirror]) if len(self.fixed) else None
            verts = symmetrised(verts, self.mirror, plane)
        result = verts.copy()
        for part in self.parts:
            rest, now = self.rest[part], verts[part]
            centre, goal = rest.mean(axis=0), now.mean(axis=0)
            (rotation,) = nearest_rotations(((rest - centre).T @ (now - goal))[None])
            result[part] = (rest - centre) @ rotation.T + goal
        result[self.fixed] = self.rest[self.fixed]
        return result


def _require_mirrored_parts(labels: Int64[np.ndarray, " V"], partner: Indices) -> None:
    """Check that the mirror image of each rigid part is one.

    Raises:
        MeshError: naming a part.
    """
    parts = np.maximum(labels, 0)
    for label in np.unique(parts):
        images = np.unique(parts[partner[parts == label]])
        if len(images) > 1 or (label == 0) != (images[0] == 0):
            raise MeshError(f"rigid: the mirror image of part {label} has the labels {', '.join(map(str, images))}")


def _touched(matrix: csr_array, chosen: Bool[np.ndarray, " V"]) -> Bool[np.ndarray, " W"]:
    return np.asarray(abs(matrix) @ chosen.astype(np.float64) > _ROUNDING)


def _refined_labels(matrix: csr_array, labels: Int64[np.ndarray, " V"]) -> Int64[np.ndarray, " W"]:
    entries, fine = coo_array(matrix), labels[strongest_columns([matrix])].copy()
    mixed = (np.abs(entries.data) > _ROUNDING) & (labels[entries.col] != fine[entries.row])
    fine[entries.row[mixed]] = 0
    return np.asarray(fine)


NO_GUIDANCE = Guidance()
