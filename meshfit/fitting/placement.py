"""Places of sources: in the normalised frame of a target, and aligned with it."""

import warnings
from typing import Literal

import numpy as np

from meshfit.doors import no_type_check
from meshfit.errors import MeshfitWarning
from meshfit.fitting.arguments import require_surface
from meshfit.fitting.registration.alignment import align as aligned
from meshfit.fitting.settings import FitSettings, GaussNewtonSettings
from meshfit.images.hull_source import ANY_ORIGIN, AnyOrigin, control_mesh_from
from meshfit.images.views import Views
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.cleaning_options import Surface
from meshfit.mesh.control_mesh import USUAL_VERTS
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.mismatch import boxes_are_disjoint
from meshfit.mesh.normalisation import Frame, frame_of, placed
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.registry import Scheme, resolve, wrong_domain
from meshfit.subdivision.sphere import icosphere, refined_sphere

Placement = Literal["auto", "none", "sphere", "center", "box", "pca", "icp"]
_LARGEST_RATIO = 10.0
# Radius of a source in the target's tutorial frame: around it, or inside it as the search for the rough shape needs.
_RADIUS = {"first-order": 1.0, "gauss-newton": 0.3, "external": 1.0}
_ROUNDING = 1e-12


@no_type_check
def placed_source(  # noqa: PLR0913, PLR0917  as the caller has them
    source: "MeshLike",
    frame: Frame,
    goal: Mesh | PointCloud,
    settings: FitSettings,
    scheme: str | Scheme,
    how: Placement,
    surface: Surface,
    images: Views | None = None,
) -> Mesh | PolygonMesh:
    """Return the source in the normalised frame, aligned with the target."""
    if isinstance(source, str) and source == "sphere":
        return _around(goal, _sphere(settings, scheme))
    if isinstance(source, str) and source in ANY_ORIGIN:
        return _from_target(goal, source, settings, scheme, surface, images)
    mesh = as_mesh(source, "source")
    require_surface(as_mesh(mesh, "source", triangles=True), "source")
    mesh = mesh.with_verts((mesh.verts - frame.centre) / frame.scale)
    registered = isinstance(settings, GaussNewtonSettings) and settings.prior is not None
    if how == "auto" and (registered or _has_same_place(mesh, goal)):
        return mesh
    if how == "auto":
        sizes = " and ".join(
            " × ".join(f"{length:.3g}" for length in np.ptp(verts, axis=0) * frame.scale)
            for verts in (mesh.verts, goal.verts)
        )
        text = f"the source was moved and scaled to the target, which it is far from (boxes {sizes})"
        warnings.warn(f"{text}; align='none' keeps it in place", MeshfitWarning, stacklevel=3)
    if how == "auto" or how == "sphere":  # noqa: PLR1714  the others remain, for the type checker
        return _around(goal, mesh.with_verts(placed(mesh.verts, _RADIUS[settings.method])))
    triangles = as_mesh(mesh, "source", triangles=True)
    found = aligned(triangles, goal, how)
    if found.doubt:
        warnings.warn(f"align='{how}': {found.doubt}; check the result", MeshfitWarning, stacklevel=3)
    return mesh.with_verts(found.mesh.verts)


def _sphere(settings: FitSettings, scheme: str | Scheme) -> Mesh | PolygonMesh:
    """Return the source of the bundled configs: of `tutorial` for the first-order engine, else of `accurate`."""
    if settings.method == "first-order":
        return icosphere(4)
    declared = resolve(scheme)
    if isinstance(declared, CurveScheme):
        raise wrong_domain(declared, "triangles")
    return refined_sphere(declared, 3, _RADIUS[settings.method])


def _from_target(
    goal: Mesh | PointCloud,
    origin: AnyOrigin,
    settings: FitSettings,
    scheme: str | Scheme,
    surface: Surface,
    images: Views | None,
) -> Mesh | PolygonMesh:
    """Return the source of the bundled config `accurate`: a control mesh made from the target."""
    verts = USUAL_VERTS
    if isinstance(settings, GaussNewtonSettings) and settings.connectivity == "fixed":
        verts = max(12, int((settings.verts - 2) / 4**settings.levels) + 2)
    mesh = control_mesh_from(goal, images, origin, verts=verts, surface=surface).mesh
    return PolygonMesh.of(mesh) if isinstance(resolve(scheme), PolygonScheme) else mesh


def _around(goal: Mesh | PointCloud, mesh: Mesh | PolygonMesh) -> Mesh | PolygonMesh:
    """Move a mesh from the tutorial's frame of the target to the frame that the target is in."""
    frame = frame_of(goal.verts, "tutorial")
    if np.allclose(frame.centre, 0.0, atol=_ROUNDING) and abs(frame.scale - 1.0) < _ROUNDING:
        return mesh
    return frame.restore(mesh)


def _has_same_place(source: Mesh | PolygonMesh, target: Mesh | PointCloud) -> bool:
    """Return whether bounding boxes overlap, and differ in size by less than ten times."""
    ratio = bounding_box_diagonal(source.verts) / bounding_box_diagonal(target.verts)
    return 1 / _LARGEST_RATIO < ratio < _LARGEST_RATIO and not boxes_are_disjoint(source, target)
