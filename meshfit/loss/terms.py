"""The table of loss terms. The same names stand in configs, in traces and in tables; adding a term is an entry here."""

from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from meshfit.loss.chamfer import Matches, chamfer
from meshfit.loss.consistency import consistency
from meshfit.loss.edge import edge
from meshfit.loss.laplacian import laplacian_cotangent, laplacian_uniform
from meshfit.loss.normal import normal
from meshfit.loss.surface import FaceGeometry, Surface


@dataclass(frozen=True, eq=False)
class Samples:
    """Points on a surface with the unit normals of their faces, both (N, 3)."""

    points: Float[Tensor, "N 3"]
    normals: Float[Tensor, "N 3"]


@dataclass(frozen=True, eq=False)
class State:
    """All that a term may look at in one step.

    Attributes:
        verts: (V, 3) the current positions.
        surface: what is constant of the mesh.
        faces: where its faces are now.
        source: points on it.
        target: points on the target.
        matches: which of them are nearest to each other.
    """

    verts: Float[Tensor, "V 3"]
    surface: Surface
    faces: FaceGeometry
    source: Samples
    target: Samples
    matches: Matches


Term = Callable[[State], Float[Tensor, ""]]

LAPLACIANS: dict[str, Term] = {
    "uniform": lambda state: laplacian_uniform(state.verts, state.surface),
    "cotangent": lambda state: laplacian_cotangent(state.verts, state.surface),
}

TERMS: dict[str, Term] = {
    "chamfer": lambda state: chamfer(state.source.points, state.target.points, state.matches),
    "normal": lambda state: normal(state.source.normals, state.target.normals, state.matches),
    "edge": lambda state: edge(state.verts, state.surface),
    "laplacian": LAPLACIANS["uniform"],
    "consistency": lambda state: consistency(state.faces, state.surface),
}
