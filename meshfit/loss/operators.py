"""Operators of K meshes, built once before the first step, and the geometry of their faces at each step."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int64
from scipy.sparse import coo_array, diags_array
from torch import Tensor
from torch.autograd.function import Function, once_differentiable

from meshfit.loss.batch_segments import BatchSegments
from meshfit.loss.sparse import Sparse
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology

LEAST_DOUBLE_AREA = 1e-10


@dataclass(frozen=True, eq=False)
class Faces:
    """The faces of K meshes, as one mesh of K disconnected parts.

    Attributes:
        verts: (F, 3) vertices at the corners of each face.
        segments: the mesh of each face.
        sides: (2 F, V) maps positions to two sides of each face from its first corner; all first sides come first.
    """

    verts: Int64[Tensor, "F 3"]
    segments: BatchSegments
    sides: Sparse

    @classmethod
    def of(cls, meshes: Sequence[Mesh], dtype: torch.dtype, device: torch.device) -> "Faces":
        """Return the faces of some meshes."""
        faces = _shifted([mesh.faces for mesh in meshes], [mesh.num_verts for mesh in meshes])
        sides = np.concatenate([faces[:, [0, 1]], faces[:, [0, 2]]])
        return cls(
            verts=torch.tensor(faces, device=device),
            segments=BatchSegments.of([mesh.num_faces for mesh in meshes], device),
            sides=Sparse.of(_differences(sides, sum(mesh.num_verts for mesh in meshes)), dtype, device),
        )


@dataclass(frozen=True, eq=False)
class MeshOperators:
    """Linear operators of K meshes whose vertices move, on one device.

    Attributes:
        faces: the faces.
        of_vert, of_edge: the mesh of each vertex and of each edge.
        edges: (E, V) maps positions to edge vectors, head minus tail.
        umbrella: (V, E) maps edge vectors to each vertex minus the mean of its neighbours.
        has_edges: (V, 1) 1 for vertices with edges, 0 for others.
        neighbours: (F, F) sums over adjacent faces, with sign -1 for those of opposite orientation.
        valence_of_face: (F,) number of adjacent faces.
        face_pairs: (K,) number of pairs of adjacent faces, at least 1.
    """

    faces: Faces
    of_vert: BatchSegments
    of_edge: BatchSegments
    edges: Sparse
    umbrella: Sparse
    has_edges: Float[Tensor, "V 1"]
    neighbours: Sparse
    valence_of_face: Float[Tensor, " F"]
    face_pairs: Float[Tensor, " K"]

    @classmethod
    def of(cls, meshes: Sequence[Mesh], dtype: torch.dtype, device: torch.device) -> "MeshOperators":
        """Return the operators of some meshes; on edges with three faces or more, every pair of faces counts."""
        options: dict[str, Any] = {"dtype": dtype, "device": device}
        of_mesh = {mesh: Topology.of(mesh) for mesh in dict.fromkeys(meshes)}
        topologies, faces = [of_mesh[mesh] for mesh in meshes], Faces.of(meshes, **options)
        of_vert = BatchSegments.of([mesh.num_verts for mesh in meshes], device)
        edges = _shifted([topology.edges for topology in topologies], of_vert.sizes)
        pairs = _shifted([topology.face_pairs // 3 for topology in topologies], faces.segments.sizes)
        signs = np.concatenate([_orientation(topology) for topology in topologies])
        valence = np.bincount(edges.reshape(-1), minlength=len(of_vert.index))
        differences = _differences(edges, len(valence))
        return cls(
            faces=faces,
            of_vert=of_vert,
            of_edge=BatchSegments.of([len(topology.edges) for topology in topologies], device),
            edges=Sparse.of(differences, **options),
            umbrella=Sparse.of(diags_array(1 / valence.clip(min=1)) @ differences.T, **options),
            has_edges=torch.tensor(valence.clip(max=1)[:, None], **options),
            neighbours=Sparse.of(_face_adjacency(pairs, signs, len(faces.segments.index)), **options),
            valence_of_face=torch.tensor(
                np.bincount(pairs.reshape(-1), minlength=len(faces.segments.index)), **options
            ),
            face_pairs=torch.tensor([max(len(topology.face_pairs), 1) for topology in topologies], **options),
        )


def _shifted(indices: Sequence[np.ndarray], sizes: Sequence[int]) -> np.ndarray:
    offsets = np.cumsum([0, *sizes[:-1]])
    return np.concatenate([part + offset for part, offset in zip(indices, offsets, strict=True)])


def _orientation(topology: Topology) -> np.ndarray:
    """Return 1 for adjacent faces of the same orientation, which traverse their edge opposite ways; -1 for others."""
    first, second = topology.face_pairs.T
    return np.where(topology.tail[first] == topology.tail[second], -1.0, 1.0)


def _differences(edges: np.ndarray, num_verts: int) -> coo_array:
    rows = np.tile(np.arange(len(edges)), 2)
    return coo_array((np.repeat([-1.0, 1.0], len(edges)), (rows, edges.T.reshape(-1))), shape=(len(edges), num_verts))


def _face_adjacency(pairs: np.ndarray, signs: np.ndarray, num_faces: int) -> coo_array:
    rows, columns = pairs.T.reshape(-1), pairs[:, ::-1].T.reshape(-1)
    return coo_array((np.tile(signs, 2), (rows, columns)), shape=(num_faces, num_faces))


@dataclass(frozen=True, eq=False)
class FaceGeometry:
    """The faces at their current positions.

    Attributes:
        faces: the faces.
        verts: (V, 3) positions.
        double_area: (F,) twice the area of each face, constant in the backward pass.
        normals: (F, 3) unit normals; shorter for faces of nearly no area.
    """

    faces: Faces
    verts: Float[Tensor, "V 3"]
    double_area: Float[Tensor, " F"]
    normals: Float[Tensor, "F 3"]

    @classmethod
    def of(cls, faces: Faces, verts: Float[Tensor, "V 3"]) -> "FaceGeometry":
        """Return the faces at these positions."""
        normals, double_area = _Normals.apply(faces.sides @ verts)  # type: ignore[no-untyped-call]
        return cls(faces, verts, double_area, normals)


class _Normals(Function):
    """Normals n = u × v / max(|u × v|, ε) of faces with sides u and v.

    The gradient is dL/du = v × g, dL/dv = g × u, with g = (dL/dn - n (n · dL/dn)) / |u × v|, or dL/dn / ε where ε acts.
    """

    @staticmethod
    def forward(ctx: Any, sides: Tensor) -> tuple[Tensor, Tensor]:  # noqa: ANN401  torch's context
        u, v = sides.view(2, -1, 3)
        cross = torch.linalg.cross(u, v)
        double_area = cross.square().sum(1).sqrt()
        scale = 1 / double_area.clamp_min(LEAST_DOUBLE_AREA)
        normals = cross * scale[:, None]
        ctx.save_for_backward(sides, normals, scale)
        ctx.mark_non_differentiable(double_area)
        return normals, double_area

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, _: Tensor) -> Tensor:  # noqa: ANN401  torch's context
        sides, normals, scale = ctx.saved_tensors
        u, v = sides.view(2, -1, 3)
        along = (normals * gradient).sum(1).masked_fill(scale >= 1 / LEAST_DOUBLE_AREA, 0)
        g = (gradient - normals * along[:, None]) * scale[:, None]
        return torch.cat([torch.linalg.cross(v, g), torch.linalg.cross(g, u)])
