"""What of a mesh stays the same while its verts move: index tensors and operators, made once before the first step."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology

LEAST_DOUBLE_AREA = 1e-10


@dataclass(frozen=True, eq=False)
class Surface:
    """The constant part of a moving mesh, on one device.

    Attributes:
        faces: (F, 3) vertex indices.
        edges: (2, E) the ends of each edge, each edge once.
        valence: (V, 1) number of edges at each vertex, at least 1.
        joined: (V, 1) 1 where a vertex has edges, 0 where it has none.
        face_pairs: (2, P) the faces of every two that share an edge.
        pair_sign: (P,) 1 where the two are oriented alike, -1 where they are not.
    """

    faces: Int64[Tensor, "F 3"]
    edges: Int64[Tensor, "2 E"]
    valence: Float[Tensor, "V 1"]
    joined: Float[Tensor, "V 1"]
    face_pairs: Int64[Tensor, "2 P"]
    pair_sign: Float[Tensor, " P"]

    @classmethod
    def of(cls, mesh: Mesh, dtype: torch.dtype, device: torch.device) -> "Surface":
        """The surface of a mesh; edges with three faces or more count every pair of them."""
        topology = Topology.of(mesh)
        pairs = topology.face_pairs
        alike = np.where(topology.tail[pairs[:, 0]] == topology.tail[pairs[:, 1]], -1.0, 1.0)
        return cls(
            faces=torch.tensor(mesh.faces, device=device),
            edges=torch.tensor(topology.edges.T.copy(), device=device),
            valence=torch.tensor(topology.valence.clip(min=1)[:, None], dtype=dtype, device=device),
            joined=torch.tensor(topology.valence.clip(max=1)[:, None], dtype=dtype, device=device),
            face_pairs=torch.tensor((pairs // 3).T.copy(), device=device),
            pair_sign=torch.tensor(alike, dtype=dtype, device=device),
        )

    def corners(self, verts: Float[Tensor, "V 3"]) -> Float[Tensor, "F 3 3"]:
        """The three corners of every face."""
        return verts.index_select(0, self.faces.reshape(-1)).reshape(-1, 3, 3)


@dataclass(frozen=True, eq=False)
class FaceGeometry:
    """Where the faces are now.

    Attributes:
        corners: (F, 3, 3).
        double_area: (F,) twice the area of each face, constant in the backward pass.
        normals: (F, 3) unit normals, shorter where a face has next to no area.
    """

    corners: Float[Tensor, "F 3 3"]
    double_area: Float[Tensor, " F"]
    normals: Float[Tensor, "F 3"]

    @classmethod
    def of(cls, surface: Surface, verts: Float[Tensor, "V 3"]) -> "FaceGeometry":
        """The faces of a surface with its verts at these places."""
        corners = surface.corners(verts)
        cross = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        squared = cross.square().sum(1)
        # Clamped from below, the length has a finite gradient where a face collapses.
        length = squared.clamp_min(LEAST_DOUBLE_AREA**2).sqrt()
        return cls(corners, squared.detach().sqrt(), cross / length[:, None])
