"""How much memory a process has taken."""

import platform


def peak_memory_mb(*, of_children: bool = False) -> float | None:
    """The most memory that this process has held so far, in MB; None where the system does not tell.

    Args:
        of_children: that of the largest child that has ended, in its place; 0 where there was none.
    """
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1 if platform.system() == "Darwin" else 1024
    whose = resource.RUSAGE_CHILDREN if of_children else resource.RUSAGE_SELF
    return resource.getrusage(whose).ru_maxrss * unit / 1e6
