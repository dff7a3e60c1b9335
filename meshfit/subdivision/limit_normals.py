"""How Loop's limit surface lies at the limits of verts: its tangents and normals."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.sparse import coo_array, csr_array

from meshfit.mesh.geometry import corner_angles, face_normals, normalised
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Indices, Topology
from meshfit.subdivision.creases import Creases
from meshfit.subdivision.limit import ring_of_limit, sharp_for_ever
from meshfit.subdivision.limit_masks import Tangents, dart_masks, open_tangents, smooth_tangents
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.sheets import Sheets, sheets_of
from meshfit.subdivision.triangle_table import LOOP

# Of unit tangents; what is nearer to one line spans no plane.
_FLAT = 1e-12


@dataclass(frozen=True, eq=False)
class LimitTangents:
    """Two tangents of the limit surface for each sheet that comes to a vertex, of no particular length.

    Attributes:
        vert: (S,) the vertex of each sheet: twice for those on a crease, once for all others but corners.
        along: (S, V) operator from verts to one tangent, which follows the boundary or crease if there is one.
        across: (S, V) to the other; along × across points outwards.
    """

    vert: Indices
    along: csr_array
    across: csr_array


def loop_limit_tangents(topology: Topology, scheme: Scheme = LOOP, creases: Creases | None = None) -> LimitTangents:
    """The tangents of Loop's limit surface. Corners have none; there the surface ends in a point like a cone's.

    Args:
        topology: of the mesh.
        scheme: one that `has_loop_limit`.
        creases: as for `loop_limit`.

    Raises:
        MeshError, SchemeError: as `loop_limit`.
    """
    ring_weight, sharp = ring_of_limit(scheme), sharp_for_ever(topology, creases)
    stays = (Creases.of(topology) if creases is None else creases).rules(topology).corner == 1
    nothing = np.empty(0, dtype=np.int64)
    verts, entries, count = [nothing], [[nothing] * 4], 0
    for sheets in sheets_of(topology, sharp):
        ring, vert = sheets.ring[~stays[sheets.vert]], sheets.vert[~stays[sheets.vert]]
        if not len(vert):
            continue
        masks = _tangent_masks(sheets, ring_weight)
        columns = np.concatenate([vert[:, None], ring], axis=1)
        rows = np.broadcast_to(count + np.arange(len(vert))[:, None], columns.shape)
        weights = (np.broadcast_to(mask, columns.shape) for mask in masks)
        entries.append([part.reshape(-1) for part in (rows, columns, *weights)])
        verts.append(vert)
        count += len(vert)
    row, column, *both = (np.concatenate(part) for part in zip(*entries, strict=True))
    shape = (count, topology.num_verts)
    along, across = (csr_array(coo_array((weights, (row, column)), shape=shape)) for weights in both)
    return LimitTangents(np.concatenate(verts), along, across)


def loop_limit_normals(mesh: Mesh, scheme: Scheme = LOOP, creases: Creases | None = None) -> Float64[np.ndarray, "V 3"]:
    """Unit normals of Loop's limit surface at the limit of each vertex, outwards where the faces are oriented so.

    Where a crease parts the surface, it has a normal on either side; the direction of their mean is returned. At a
    corner there may be no tangent plane at all; there it is the mean of the normals of the faces around, each weighted
    by its angle. Loop's surface is not smooth where a boundary or crease has 7 neighbours or more on one side; what is
    returned there is the normal to the two tangents. Rows are 0 at verts without faces, and where the tangents lie on
    one line.

    Args:
        mesh: the control mesh.
        scheme: one that `has_loop_limit`.
        creases: as for `loop_limit`.

    Raises:
        MeshError, SchemeError: as `loop_limit`.
    """
    topology = Topology.of(mesh)
    tangents = loop_limit_tangents(topology, scheme, creases)
    size = float(np.abs(mesh.verts).max(initial=0.0))
    mesh = Mesh(mesh.verts / (size or 1.0), mesh.faces)  # so that squares neither overflow nor vanish
    along, across = (normalised(np.asarray(each @ mesh.verts)) for each in (tangents.along, tangents.across))
    normal = np.cross(along, across)
    normal[np.linalg.norm(normal, axis=1) < _FLAT] = 0.0
    total = np.zeros_like(mesh.verts)
    np.add.at(total, tangents.vert, normalised(normal))
    corners = np.ones(mesh.num_verts, dtype=bool)
    corners[tangents.vert] = False
    around = corner_angles(mesh)[:, :, None] * face_normals(mesh)[:, None, :]
    at_corner = corners[mesh.faces]
    np.add.at(total, mesh.faces[at_corner], around[at_corner])
    return normalised(total)


def _tangent_masks(sheets: Sheets, ring: Callable[[int], float]) -> Tangents:
    size = sheets.ring.shape[1]
    if sheets.is_open:
        return open_tangents(size)
    return dart_masks(size, ring(size))[1:] if sheets.is_dart else smooth_tangents(size)
