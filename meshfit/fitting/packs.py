"""Which problems of a batch are computed together."""

from collections.abc import Sequence

import torch

from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings, GaussNewtonSettings

# For each face, vertex and sample: twice what is held on the CPU, as other allocators leave gaps.
_BYTES_PER_ROW = 600
# Enough for the calls of a step to cost little beside its numbers.
_CPU_BYTES = 200e6
_MPS_BYTES = 2e9
_SHARE_OF_DEVICE = 0.5


def packs(
    problems: Sequence[Problem], settings: FirstOrderSettings | GaussNewtonSettings, device: torch.device
) -> list[list[int]]:
    """Split problems into groups that are stepped together, of as many as the device has room for.

    Problems of a group have made as many steps before: those that go on from checkpoints may not all have.

    Returns:
        Places in `problems`, group by group.
    """
    if isinstance(settings, GaussNewtonSettings):  # which takes them one after the other, whatever their company
        return [[place] for place in range(len(problems))]
    room, groups = _room(device), list[list[int]]()
    filled, last = room, -1
    for place in sorted(range(len(problems)), key=lambda i: done_before(problems[i])):
        size, done = _size(problems[place], settings), done_before(problems[place])
        if filled + size > room or done != last:
            groups.append([])
            filled, last = 0, done
        groups[-1].append(place)
        filled += size
    return groups


def done_before(problem: Problem) -> int:
    """The steps that were made of a problem before."""
    return 0 if problem.resume is None else int(problem.resume["done"])


def _size(problem: Problem, settings: FirstOrderSettings) -> int:
    meshes = problem.source.num_verts + problem.source.num_faces + problem.target.num_faces
    return _BYTES_PER_ROW * (meshes + 2 * settings.samples)


def _room(device: torch.device) -> float:
    if device.type == "cuda":
        return _SHARE_OF_DEVICE * torch.cuda.mem_get_info(device)[0]
    if device.type == "mps":
        return _MPS_BYTES
    return _CPU_BYTES
