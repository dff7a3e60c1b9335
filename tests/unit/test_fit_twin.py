"""The first-order engine against a plain torch loop that recomputes everything at every step, from the same samples."""

import numpy as np
import pytest
import torch
from torch.nn.functional import normalize

from meshfit.fitting.sampling import sample
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.loss.operators import FaceGeometry, Faces
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import sort_faces_spatially
from meshfit.mesh.solids import cube
from meshfit.settings import build
from tests.fits import fit
from tests.shapes import mixed_closed, mixed_open

STEPS, SAMPLES, SEED = 20, 150, 11
WEIGHTS = {"chamfer": 1.0, "normal": 0.02, "edge": 0.7, "laplacian": 0.1, "consistency": 0.05}
TARGET = Mesh(1.5 * cube().verts + 0.1, cube().faces)


def draw(verts, faces, generator):
    """The one thing that is taken over: which points are drawn."""
    where = Faces.of([Mesh(verts.detach().numpy(), faces)], torch.float64, torch.device("cpu"))
    drawn = sample(FaceGeometry.of(where, verts), SAMPLES, [generator])
    return drawn.points, drawn.normals


def neighbours_by_edge(faces):
    apexes = {}
    for a, b, c in faces.tolist():
        for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):
            apexes.setdefault((min(i, j), max(i, j)), []).append(k)
    return apexes


def laplacian_matrix(verts, apexes, kind):
    matrix = torch.zeros(len(verts), len(verts), dtype=torch.float64)
    for (i, j), opposite in apexes.items():
        weight = 1.0
        if kind == "cotangent":
            sides = [(verts[i] - verts[k], verts[j] - verts[k]) for k in opposite]
            weight = sum((a @ b) / torch.linalg.cross(a, b).norm() for a, b in sides)
        matrix[i, j] = matrix[j, i] = weight
    return matrix / matrix.sum(1, keepdim=True) - torch.eye(len(verts), dtype=torch.float64)


def losses(verts, faces, samples, kind):
    (p, p_normals), (q, q_normals) = samples
    pairs = (p[:, None] - q[None]).square().sum(2)
    cosines = (normalize(p_normals, dim=1) @ normalize(q_normals, dim=1).T).abs()
    rows, columns = pairs.argmin(1, keepdim=True), pairs.argmin(0, keepdim=True)
    apexes = neighbours_by_edge(faces)
    bends = [
        1 + torch.cosine_similarity(*(torch.linalg.cross(verts[j] - verts[i], verts[k] - verts[i]) for k in pair), 0)
        for (i, j), pair in apexes.items()
        if len(pair) == 2
    ]
    matrix = laplacian_matrix(verts.detach(), apexes, kind)
    return {
        "chamfer": pairs.min(1).values.mean() + pairs.min(0).values.mean(),
        "normal": 2 - cosines.gather(1, rows).mean() - cosines.gather(0, columns).mean(),
        "edge": torch.stack([(verts[i] - verts[j]).square().sum() for i, j in apexes]).mean(),
        "laplacian": (matrix @ verts).norm(dim=1).mean(),
        "consistency": torch.stack(bends).mean(),
    }


def twin(source, target, *, kind, optimizer):
    """Rows of step, loss and terms, and where the verts end up."""
    generator = torch.Generator().manual_seed(SEED)
    source, target = sort_faces_spatially(source), sort_faces_spatially(target)
    verts = torch.tensor(source.verts, requires_grad=True)
    engine = optimizer([verts])
    rows = []
    for step in range(STEPS):
        samples = [draw(verts, source.faces, generator), draw(torch.tensor(target.verts), target.faces, generator)]
        terms = losses(verts, source.faces, samples, kind)
        total = sum(WEIGHTS[name] * value for name, value in terms.items())
        engine.zero_grad()
        total.backward()
        engine.step()
        rows.append((step, total.item(), *(value.item() for value in terms.values())))
    return np.array(rows), verts.detach().numpy()


OPTIMIZERS = {
    "sgd": ({"name": "sgd", "lr": 0.4}, lambda verts: torch.optim.SGD(verts, lr=0.4, momentum=0.9)),
    "adam": ({"name": "adam", "lr": 0.01}, lambda verts: torch.optim.Adam(verts, lr=0.01)),
}


@pytest.mark.parametrize(
    ("optimizer", "kind", "surface"),
    [
        pytest.param("sgd", "uniform", "closed", marks=pytest.mark.slow),
        ("sgd", "cotangent", "open"),
        pytest.param("adam", "uniform", "open", marks=pytest.mark.slow),
        ("adam", "cotangent", "closed"),
    ],
)
def test_losses_and_verts_are_those_of_the_twin(optimizer, kind, surface):
    source = mixed_closed(inserted=6) if surface == "closed" else mixed_open()
    setting, constructor = OPTIMIZERS[optimizer]
    settings = build(
        FirstOrderSettings,
        {
            "steps": STEPS,
            "samples": SAMPLES,
            "losses": WEIGHTS,
            "laplacian": kind,
            "optimizer": setting,
            "trace_every": 1,
        },
    )
    result = fit(source, TARGET, settings, seed=SEED, device="cpu", dtype="float64")
    rows, verts = twin(source, TARGET, kind=kind, optimizer=constructor)
    np.testing.assert_allclose(np.array(result.trace.rows)[:, :-1], rows, rtol=1e-5)
    np.testing.assert_allclose(result.mesh.verts, verts, rtol=0, atol=1e-6)
    assert np.abs(verts - source.verts).max() > 0.05
