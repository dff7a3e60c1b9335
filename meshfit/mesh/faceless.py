"""The message for files and meshes without faces where a surface is expected."""

POINTS_REMEDY = "reconstruct a surface first, for example with MeshLab's screened Poisson reconstruction"


def no_faces_message(num_points: int, num_segments: int = 0) -> str:
    """Return what was found instead of a surface, and for points what to do."""
    if num_segments:
        return f"expected a surface, got curves of {num_segments} segments and {num_points} vertices, and no faces"
    return f"expected a surface, got a cloud of {num_points} points and no faces; {POINTS_REMEDY}"
