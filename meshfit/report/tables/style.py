"""The style of a table: what its cells and notes contain, and the names that it prints."""

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from meshfit.errors import ConfigError
from meshfit.specs import suggest

Cells = Literal["mean", "mean-sd", "mean-ci", "full"]
Notes = Literal["none", "short", "full"]


@dataclass(frozen=True)
class Style:
    """Style of printed tables; the numbers behind them stay the same.

    Attributes:
        cells: the mean alone, with the standard deviation, with its 95 % interval, or with median and interval.
        notes: which sentences and comparisons are printed with the cells.
        labels: names to print in place of those of schemes, targets, metrics and variations.
        transpose: whether targets are rows, and schemes columns.
        digits: significant digits of a mean; None for as many as its spread supports.
    """

    cells: Cells = "full"
    notes: Notes = "full"
    labels: Mapping[str, str] = field(default_factory=dict)
    transpose: bool = False
    digits: int | None = None

    def label(self, name: str) -> str:
        """Return the name to print for a scheme, target, metric or variation."""
        return self.labels.get(name, name)


def parse_labels(texts: Iterable[str], known: Iterable[str]) -> dict[str, str]:
    """Parse labels given as NAME=LABEL, where the name may itself contain `=`.

    Args:
        texts: the labels.
        known: names that can be labelled.

    Raises:
        ConfigError: a text without `=` or label, or an unknown name.
    """
    names = list(dict.fromkeys(known))
    return dict(_parse_label(text, names) for text in texts)


def _parse_label(text: str, known: Sequence[str]) -> tuple[str, str]:
    name, label = _split_at_name(text, known)
    if not label.strip():
        raise ConfigError(f"--label {text}: expected NAME=LABEL, such as interp-loop='Interp. Loop'")
    if name not in known:
        raise ConfigError(f"--label {text}: nothing here is named '{name}': {suggest(name, known)}")
    return name, label.strip()


def _split_at_name(text: str, known: Container[str]) -> tuple[str, str]:
    parts = text.split("=")
    for count in range(len(parts) - 1, 0, -1):
        if (name := "=".join(parts[:count]).strip()) in known:
            return name, "=".join(parts[count:])
    return parts[0].strip(), "=".join(parts[1:])
