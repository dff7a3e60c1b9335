"""Short names of targets, which are folders of a run directory and columns of tables."""

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from meshfit.config.path_parts import folder_key
from meshfit.images.specs import is_image_target, label_of_target, path_of_images
from meshfit.mesh.targets import NAMED_TARGETS


def target_label(target: str) -> str:
    """The short name of a target: that of a named one, the stem of a file, or of images such as `bunny-12-views`."""
    return label_of_target(target)


def distinct_labels(targets: Iterable[str]) -> dict[str, str]:
    """Return longer labels of targets whose short names lead to the same folder, such as `1a04-model_normalized`.

    Of files, the suffix is added first, then the nearest folders in which they differ; named targets keep their names.
    """
    groups: dict[str, list[str]] = {}
    for name in dict.fromkeys(targets):
        groups.setdefault(folder_key(target_label(name)), []).append(name)
    lengthened: dict[str, str] = {}
    for group in groups.values():
        names = [name for name in group if name not in NAMED_TARGETS]
        if len(group) > 1:
            lengthened |= _lengthened(names)
    return lengthened


def _lengthened(names: Sequence[str]) -> dict[str, str]:
    labels = {name: target_label(name) if is_image_target(name) else Path(name).name for name in names}
    paths = {name: path_of_images(name) if is_image_target(name) else name for name in names}

    def num_distinct(labels: Mapping[str, str]) -> int:
        return len(set(map(folder_key, labels.values())))

    if num_distinct(labels) < len(names):
        labels = {name: target_label(name) for name in names} if num_distinct(labels) == 1 else labels
        parents = {name: Path(os.path.abspath(path)).parts[-2::-1] for name, path in paths.items()}  # noqa: PTH100
        for depth in range(max(map(len, parents.values()))):
            parts = {name: folders[depth] if depth < len(folders) else "" for name, folders in parents.items()}
            longer = {name: f"{parts[name]}-{labels[name]}" for name in names}
            if num_distinct(longer) > num_distinct(labels):
                labels = longer
    return labels
