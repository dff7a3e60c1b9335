"""Functions for workers that die in them; the module imports next to nothing, so that workers start fast."""

import os
import signal
from pathlib import Path


def die_while_counting() -> int:
    """Count no GPUs, but be killed as often as the file of the environment variable says."""
    path = Path(os.environ["DEATHS"])
    if left := int(path.read_text()):
        path.write_text(str(left - 1))
        os.kill(os.getpid(), signal.SIGKILL)
    return 0
