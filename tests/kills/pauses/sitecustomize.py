"""Pauses for the kill harness. With this folder on PYTHONPATH, each process of Python imports this module first.

The file that MESHFIT_TEST_PAUSE names holds a phase and a seed. The first process to reach that phase in the trial of
that seed writes its id to `FILE.paused`, and goes on once `FILE.go` exists. Checkpoints are written after every step.
"""

import importlib.util
import os
import sys
import time

SPEC = os.environ.get("MESHFIT_TEST_PAUSE", "")
STEPS = 5
"""Number of checkpoints in a process before it pauses in the phase `fitting`."""

_replace, _fsync, _unlink = os.replace, os.fsync, os.unlink
_trial = ""
_saved = dict[str, int]()


def pause(phase: str, path: str = "") -> None:
    """Pause if this is the wanted phase, of the wanted trial."""
    if not wanted(phase, path):
        return
    part = f"{SPEC}.{os.getpid()}"
    with open(part, "w", encoding="ascii") as file:
        file.write(str(os.getpid()))
    try:
        os.link(part, f"{SPEC}.paused")
    except FileExistsError:
        return
    finally:
        _unlink(part)
    while not os.path.exists(f"{SPEC}.go"):
        time.sleep(0.01)


def wanted(phase: str, path: str) -> bool:
    try:
        with open(SPEC, encoding="ascii") as file:
            where, seed = file.read().split()
    except (OSError, ValueError):
        return False
    return phase == where and (not path or f"seed-{seed}-" in path) and not os.path.exists(f"{SPEC}.paused")


def fsync(descriptor: int) -> None:
    """Pause where half of a file is written."""
    path = os.readlink(f"/proc/self/fd/{descriptor}") if isinstance(descriptor, int) else ""
    folder, name = os.path.split(path)
    again = os.path.exists(f"{folder}/checkpoint.pt")
    phase = {".result.json": "writing", ".checkpoint.pt": "checkpoint-writing" if again else ""}.get(name[:-9], "")
    if phase and wanted(phase, path):
        with open(path, "r+b") as file:
            content = file.read()
            file.truncate(len(content) // 2)
            pause(phase, path)
            file.seek(0)
            file.write(content)
    _fsync(descriptor)


def replace(source, target, **options):
    global _trial  # noqa: PLW0603  the last trial that this process has reported on
    path = os.fspath(target)
    name = os.path.basename(path)
    if name == "checkpoint.pt" and os.path.exists(path):
        pause("checkpoint-renaming", path)
    elif name == "result.json":
        pause("renaming", path)
    elif name == "plan.json":
        pause("planning")
    elif name == "progress.json":
        _trial = path
    _replace(source, target, **options)
    if name == "checkpoint.pt":
        _saved[path] = _saved.get(path, 0) + 1
        if _saved[path] >= STEPS:
            pause("fitting", path)


def unlink(path, **options):
    if os.path.basename(os.fspath(path)) == "checkpoint.pt":
        folder = os.path.dirname(os.fspath(path))
        if os.path.exists(f"{folder}/result.json"):
            pause("finishing", folder)
    _unlink(path, **options)


def save_at_every_step(module) -> None:
    module.SECONDS_BETWEEN_CHECKPOINTS = -1.0


def pause_after_measuring(module) -> None:
    measure = module.measure

    def paused(*arguments, **options):
        measured = measure(*arguments, **options)
        pause("measuring", _trial)
        return measured

    module.measure = paused


CHANGES = {"meshfit.fitting.loop": save_at_every_step, "meshfit.measuring.measure": pause_after_measuring}


class Finder:
    """Finder of modules that are changed once they have been imported."""

    def find_spec(self, name, path=None, target=None):
        if name == "torch":
            pause("importing")
        change = CHANGES.get(name)
        if change is None:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        sys.meta_path.insert(0, self)
        execute = spec.loader.exec_module

        def exec_module(module):
            execute(module)
            change(module)

        spec.loader.exec_module = exec_module
        return spec


if SPEC:
    os.fsync, os.replace, os.unlink = fsync, replace, unlink
    sys.meta_path.insert(0, Finder())
    if any("spawn_main" in argument for argument in sys.orig_argv):
        pause("starting")
