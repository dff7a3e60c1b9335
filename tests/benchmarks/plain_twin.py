"""The plain twin of the first-order engine: a tutorial's loop in plain torch.

Nearest neighbours by comparing all pairs, topology recomputed at every step, autograd throughout. Faces and draws
are in the order that the engine has them in, so that with the same generator the same samples give the same losses.
"""

import torch
from torch import Tensor
from torch.nn.functional import cosine_similarity, normalize

from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.mesh.nearest import sort_faces_spatially

_BLOCK = 500


class PlainTwin:
    """A fit in progress on the CPU, as `FirstOrder` is one; uniform Laplacian and constant rate only."""

    def __init__(self, problem: Problem, settings: FirstOrderSettings, dtype: torch.dtype) -> None:
        self.weights = settings.losses.model_dump()
        self.samples = settings.samples
        source, target = sort_faces_spatially(problem.source), sort_faces_spatially(problem.target)
        self.start, self.faces = torch.tensor(source.verts, dtype=dtype), torch.tensor(source.faces)
        self.target = torch.tensor(target.verts, dtype=dtype), torch.tensor(target.faces)
        self.offsets = torch.zeros_like(self.start, requires_grad=True)
        self.optimizer = torch.optim.SGD([self.offsets], lr=settings.optimizer.lr, momentum=settings.optimizer.momentum)
        self.generator = torch.Generator().manual_seed(problem.seed)

    def step(self) -> float:
        self.optimizer.zero_grad()
        verts = self.start + self.offsets
        source, target = self.sample(verts, self.faces), self.sample(*self.target)
        loss = sum(self.weights[name] * value for name, value in losses(verts, self.faces, source, target).items())
        loss.backward()
        self.optimizer.step()
        return loss.item()

    def sample(self, verts: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
        a, b, c = verts[faces[:, 0]], verts[faces[:, 1]], verts[faces[:, 2]]
        cross = torch.linalg.cross(b - a, c - a)
        uniform = torch.rand(3, self.samples, generator=self.generator).to(verts.dtype)
        uniform[0] = uniform[0].sort().values
        cumulative = cross.detach().norm(dim=1).cumsum(0)
        picked = torch.searchsorted(cumulative, uniform[0] * cumulative[-1], right=True).clamp(max=len(faces) - 1)
        root, second = uniform[1].sqrt()[:, None], uniform[2][:, None]
        points = (1 - root) * a[picked] + root * (1 - second) * b[picked] + root * second * c[picked]
        return points, normalize(cross[picked], dim=1)


def losses(
    verts: Tensor, faces: Tensor, source: tuple[Tensor, Tensor], target: tuple[Tensor, Tensor]
) -> dict[str, Tensor]:
    (p, p_normals), (q, q_normals) = source, target
    to_q, to_p = nearest(p, q), nearest(q, p)
    edges, one, other = topology(faces)
    tail, head = verts[edges[:, 0]], verts[edges[:, 1]]
    degree = torch.bincount(edges.reshape(-1), minlength=len(verts))[:, None]
    around = torch.zeros_like(verts).index_add(0, edges[:, 0], head).index_add(0, edges[:, 1], tail)
    corners = verts[faces]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    agree = 2 - cosine_similarity(p_normals, q_normals[to_q]).abs().mean()
    return {
        "chamfer": (p - q[to_q]).square().sum(1).mean() + (q - p[to_p]).square().sum(1).mean(),
        "normal": agree - cosine_similarity(q_normals, p_normals[to_p]).abs().mean(),
        "edge": (tail - head).square().sum(1).mean(),
        "laplacian": (around / degree - verts).norm(dim=1).mean(),
        "consistency": (1 - cosine_similarity(normals[one], normals[other])).mean(),
    }


@torch.no_grad()
def nearest(queries: Tensor, points: Tensor) -> Tensor:
    blocks = [(block[:, None] - points[None]).square().sum(2).argmin(1) for block in queries.split(_BLOCK)]
    return torch.cat(blocks)


def topology(faces: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Edges, and the two faces at each edge, of a closed mesh."""
    pairs = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).sort(dim=1).values
    edges, edge = torch.unique(pairs, dim=0, return_inverse=True)
    by_edge = (edge.argsort(stable=True) % len(faces)).reshape(-1, 2)
    return edges, by_edge[:, 0], by_edge[:, 1]
