"""The message for files and meshes without faces where a surface is expected."""

from meshfit.units import count_text

POINTS_REMEDY = "reconstruct a surface first: meshfit fit POINTS -o surface.ply"


def no_faces_message(num_points: int, num_segments: int = 0) -> str:
    """Return what was found instead of a surface, and for points what to do."""
    if num_segments:
        segments = count_text(num_segments, "segment")
        return f"expected a surface, got curves of {segments} and {count_text(num_points, 'vertex')}, and no faces"
    return f"expected a surface, got a cloud of {count_text(num_points, 'point')} and no faces; {POINTS_REMEDY}"
