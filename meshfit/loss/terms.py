"""The table of loss terms, by their names in configs, traces and tables; add a term here."""

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
    """Points on surfaces.

    Attributes:
        points: (N, 3).
        picked: (N,) face of each point.
        faces: all faces.
    """

    points: Float[Tensor, "N 3"]
    picked: Int64[Tensor, " N"]
    faces: FaceGeometry

    @cached_property
    def normals(self) -> Float[Tensor, "N 3"]:
        """Unit normals of the points' faces."""
        return self.faces.normals.index_select(0, self.picked)


@dataclass(frozen=True, eq=False)
class LossInputs:
    """Inputs of the loss terms in one step, of K meshes at once.

    Attributes:
        verts: (V, 3) current positions.
        operators: operators of the meshes.
        faces: faces at their current positions.
        source: points on the meshes, equally many on each.
        target: points on the targets, equally many on each.
        matches: nearest neighbours between the two.
    """

    verts: Float[Tensor, "V 3"]
    operators: MeshOperators
    faces: FaceGeometry
    source: Samples
    target: Samples
    matches: Matches

    @cached_property
    def edges(self) -> Float[Tensor, "E 3"]:
        """Vectors from tail to head of each edge."""
        return self.operators.edges @ self.verts


Term = Callable[[LossInputs], Float[Tensor, " K"]]

LAPLACIANS: dict[str, Term] = {
    "uniform": lambda inputs: laplacian_uniform(inputs.edges, inputs.operators),
    "cotangent": lambda inputs: laplacian_cotangent(inputs.verts, inputs.operators),
}

TERMS: dict[str, Term] = {
    "chamfer": lambda inputs: chamfer(inputs.source.points, inputs.target.points, inputs.matches),
    "normal": lambda inputs: normal(inputs.source.normals, inputs.target.normals, inputs.matches),
    "edge": lambda inputs: edge(inputs.edges, inputs.operators),
    "laplacian": LAPLACIANS["uniform"],
    "consistency": lambda inputs: consistency(inputs.faces, inputs.operators),
}
