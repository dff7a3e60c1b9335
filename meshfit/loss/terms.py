"""The table of loss terms. The same names stand in configs, in traces and in tables; adding a term is an entry here."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from jaxtyping import Float, Int64
from torch import Tensor

from meshfit.loss.chamfer import Matches, chamfer
from meshfit.loss.consistency import consistency
from meshfit.loss.edge import edge
from meshfit.loss.laplacian import laplacian_cotangent, laplacian_uniform
from meshfit.loss.normal import normal
from meshfit.loss.operators import FaceGeometry, MeshOperators


@dataclass(frozen=True, eq=False)
class Samples:
    """Points on a surface.

    Attributes:
        points: (N, 3).
        picked: (N,) the face that each lies on.
        faces: all faces.
    """

    points: Float[Tensor, "N 3"]
    picked: Int64[Tensor, " N"]
    faces: FaceGeometry

    @cached_property
    def normals(self) -> Float[Tensor, "N 3"]:
        """The unit normals of their faces."""
        return self.faces.normals.index_select(0, self.picked)


@dataclass(frozen=True, eq=False)
class LossInputs:
    """All that a term may look at in one step, of K meshes at once.

    Attributes:
        verts: (V, 3) the current positions.
        surface: what is constant of the meshes.
        faces: where their faces are now.
        source: points on them, as many on each.
        target: points on the targets, likewise.
        matches: which of them are nearest to each other.
    """

    verts: Float[Tensor, "V 3"]
    surface: MeshOperators
    faces: FaceGeometry
    source: Samples
    target: Samples
    matches: Matches

    @cached_property
    def edges(self) -> Float[Tensor, "E 3"]:
        """From tail to head of each edge."""
        return self.surface.edges @ self.verts


Term = Callable[[LossInputs], Float[Tensor, " K"]]

LAPLACIANS: dict[str, Term] = {
    "uniform": lambda state: laplacian_uniform(state.edges, state.surface),
    "cotangent": lambda state: laplacian_cotangent(state.verts, state.surface),
}

TERMS: dict[str, Term] = {
    "chamfer": lambda state: chamfer(state.source.points, state.target.points, state.matches),
    "normal": lambda state: normal(state.source.normals, state.target.normals, state.matches),
    "edge": lambda state: edge(state.edges, state.surface),
    "laplacian": LAPLACIANS["uniform"],
    "consistency": lambda state: consistency(state.faces, state.surface),
}
