"""Every loss term against PyTorch3D 0.7.9's own functions, run in float64: values and gradients to 1e-6 relative.

`pytorch3d_losses.npz` holds its outputs on two closed meshes and on two point sets; the library is in no package index.
"""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from meshfit.loss.chamfer import Matches, chamfer
from meshfit.loss.consistency import consistency
from meshfit.loss.edge import edge
from meshfit.loss.laplacian import laplacian_cotangent, laplacian_uniform
from meshfit.loss.normal import normal
from meshfit.loss.operators import FaceGeometry, MeshOperators
from meshfit.mesh.mesh import Mesh
from tests.loops import over

GOLDEN = np.load(Path(__file__).with_name("pytorch3d_losses.npz"))
MESH_TERMS = {
    "edge.t0": lambda verts, surface: edge(surface.edges @ verts, surface),
    "lap.uniform": lambda verts, surface: laplacian_uniform(surface.edges @ verts, surface),
    "lap.cot": laplacian_cotangent,
    "normal_consistency": lambda verts, surface: consistency(FaceGeometry.of(surface.faces, verts), surface),
}


def golden(name: str) -> Tensor:
    return torch.tensor(GOLDEN[name], dtype=torch.float64)


def assert_same(ours: Tensor, theirs: Tensor) -> None:
    torch.testing.assert_close(ours, theirs, rtol=1e-6, atol=1e-6 * float(theirs.abs().max()))


@over("mesh", ["ico2", "cow500"])
@pytest.mark.parametrize("term", MESH_TERMS)
def test_a_mesh_term_has_the_value_and_gradient_of_pytorch3d(mesh: str, term: str) -> None:
    surface = MeshOperators.of(
        [Mesh(GOLDEN[f"{mesh}.verts"], GOLDEN[f"{mesh}.faces"])], dtype=torch.float64, device=torch.device("cpu")
    )
    verts = golden(f"{mesh}.verts").requires_grad_()
    (value,) = MESH_TERMS[term](verts, surface)
    value.backward()
    assert_same(value.detach(), golden(f"{mesh}.{term}"))
    assert_same(verts.grad, golden(f"{mesh}.{term}.grad_verts"))


def nearest(p: Tensor, q: Tensor) -> Matches:
    distance = torch.cdist(p, q, compute_mode="donot_use_mm_for_euclid_dist")
    return Matches(distance.argmin(1), distance.argmin(0))


def test_chamfer_has_the_value_and_gradients_of_pytorch3d() -> None:
    p, q = golden("p").requires_grad_(), golden("q").requires_grad_()
    (value,) = chamfer(p, q, nearest(p.detach(), q.detach()))
    value.backward()
    assert_same(value.detach(), golden("chamfer.mean"))
    assert_same(p.grad, golden("chamfer.mean.grad_p"))
    assert_same(q.grad, golden("chamfer.mean.grad_q"))


def test_the_two_directions_of_chamfer_add_up_to_it() -> None:
    both = golden("chamfer.p_to_q") + golden("chamfer.q_to_p")
    (value,) = chamfer(golden("p"), golden("q"), nearest(golden("p"), golden("q")))
    assert_same(value, both)


def test_normal_has_the_value_and_gradients_of_pytorch3d() -> None:
    p_normals, q_normals = golden("pn").requires_grad_(), golden("qn").requires_grad_()
    (value,) = normal(p_normals, q_normals, nearest(golden("p"), golden("q")))
    value.backward()
    assert_same(value.detach(), golden("chamfer_normal.absTrue.normals"))
    assert_same(p_normals.grad, golden("chamfer_normal.absTrue.normals.grad_pn"))
    assert_same(q_normals.grad, golden("chamfer_normal.absTrue.normals.grad_qn"))
