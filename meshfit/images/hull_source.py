"""Control meshes that are made from a target of any kind, or from the visual hull of its images."""

from dataclasses import replace
from typing import Literal

from meshfit.errors import MeshError
from meshfit.images.views import Views
from meshfit.images.visual_hull import hull_of
from meshfit.mesh.cleaning_options import Surface
from meshfit.mesh.control_mesh import ORIGINS, ControlMesh, Origin, Wrap, control_mesh_of
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.units import count_text

AnyOrigin = Origin | Literal["hull"]
ANY_ORIGIN: tuple[AnyOrigin, ...] = (*ORIGINS, "hull")
"""Names of sources that are made from the target."""

# The hull of fewer views is much deeper than the object.
_FEWEST = 3


def control_mesh_from(
    target: Mesh | PointCloud,
    images: Views | None,
    origin: AnyOrigin,
    *,
    verts: int | None = None,
    faces: int | None = None,
    wrap: Wrap | None = None,
    surface: Surface = "all",
) -> ControlMesh:
    """Make a control mesh from a target, as `control_mesh_of` does, or for images from their visual hull.

    Args:
        target: faces of any kind, or a cloud of points.
        images: views of the target, in its coordinates; None if it is not given by images.
        origin: as for `control_mesh_of`; `hull` decimates the visual hull, and so does `auto` where depth maps from
            three or more views are the target: in a hull there are no gaps to be wrapped.
        verts: about the largest number of vertices.
        faces: number of faces instead.
        wrap: lengths of a wrap.
        surface: the part of a target that this is.

    Raises:
        MeshError: nothing to make it from.
    """
    if origin == "hull" and images is None:
        raise MeshError("hull: the target is not given by images, whose masks have one; use source.mesh: auto")
    of_depth = origin == "auto" and isinstance(target, PointCloud)
    if images is not None and (origin == "hull" or (of_depth and len(images) >= _FEWEST)):
        made = control_mesh_of(hull_of(images), "target", verts=verts, faces=faces)
        reason = "as set" if origin == "hull" else f"of {count_text(len(images), 'mask')}"
        return replace(made, made_from="hull", reason=reason)
    assert origin != "hull"  # noqa: S101  without images, it is refused
    return control_mesh_of(target, origin, verts=verts, faces=faces, wrap=wrap, surface=surface)
