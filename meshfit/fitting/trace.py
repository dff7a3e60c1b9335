"""The trace of a fit: what it minimises and what that is made of, row by row."""

from dataclasses import dataclass, field

COLUMNS = ("step", "loss", "chamfer", "normal", "edge", "laplacian", "consistency", "lr")

Row = tuple[int | float, ...]


@dataclass
class Trace:
    """Rows of numbers, a step each.

    Attributes:
        columns: what each row holds, the step first. By default, that is followed by the weighted sum, every term
            before its weight, and the learning rate.
        rows: the numbers, in this order.
    """

    columns: tuple[str, ...] = COLUMNS
    rows: list[Row] = field(default_factory=list)

    def append(self, step: int, loss: float, terms: dict[str, float], lr: float) -> None:
        """Add the row of one step."""
        self.rows.append((step, loss, *(terms[name] for name in COLUMNS[2:-1]), lr))

    def to_csv(self) -> str:
        """The trace as CSV; numbers are written so that reading them gives the same doubles."""
        lines = (",".join([str(int(row[0])), *(repr(float(value)) for value in row[1:])]) for row in self.rows)
        return "\n".join([",".join(self.columns), *lines]) + "\n"
