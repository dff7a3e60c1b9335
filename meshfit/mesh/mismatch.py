"""Mismatch of two meshes that should lie on each other, judged by their bounding boxes."""

import numpy as np

from meshfit.mesh.geometry import bounding_box
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh

_LARGEST_RATIO, _LEAST_SHARE, _FLAT = 10.0, 0.05, 1e-9


def boxes_are_disjoint(source: Mesh | PolygonMesh, target: Mesh | PolygonMesh | PointCloud) -> bool:
    """Return whether the bounding boxes of two meshes do not overlap."""
    (source_low, source_high), (target_low, target_high) = bounding_box(source.verts), bounding_box(target.verts)
    return bool((source_low > target_high).any() or (target_low > source_high).any())


def describe_mismatch(first: Mesh | PointCloud, second: Mesh | PointCloud) -> str:
    """Return how the bounding boxes of two meshes that should lie on each other differ; empty if they do not.

    They do where they differ in size more than tenfold, or hardly overlap: by less than 5 % of the smaller box.
    """
    boxes = [bounding_box(mesh.verts) for mesh in (first, second)]
    sizes = [float(np.linalg.norm(high - low)) for low, high in boxes]
    small, large = sorted(sizes)
    if large > _LARGEST_RATIO * small:
        return f"differ in size {large / small:.3g}-fold" if small > 0 else "differ in size"
    (first_low, first_high), (second_low, second_high) = boxes
    shared = np.minimum(first_high, second_high) - np.maximum(first_low, second_low)
    shorter = np.minimum(first_high - first_low, second_high - second_low)
    # A flat box has no volume, but overlaps along the other axes.
    thick = shorter > _FLAT * large
    share = float(np.prod(np.clip(shared[thick], 0.0, None) / shorter[thick]))
    apart = bool((shared < -_FLAT * large).any())
    if apart or share <= 0:
        return "do not overlap"
    return "hardly overlap" if share < _LEAST_SHARE else ""
