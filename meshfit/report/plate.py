"""Plates: pictures in rows, with text below them, rings on them, and colour bars beside them."""

from dataclasses import dataclass

from meshfit.report.drawing import Image


@dataclass(frozen=True)
class Ring:
    """A mark around a place: from the left and from the top, in pixels; dashed where the place is out of sight."""

    left: float
    top: float
    dashed: bool


@dataclass(frozen=True)
class Panel:
    """A picture, the lines of text below it, and a ring on it."""

    image: Image
    lines: tuple[str, ...] = ()
    ring: Ring | None = None


@dataclass(frozen=True)
class ColourBar:
    """What colours stand for: from 0 to a limit, with an arrow where there is more, and what it is called."""

    limit: float
    label: str
    more: bool


@dataclass(frozen=True)
class Row:
    """Pictures of one size, side by side; a colour bar takes the columns before the first one, or a line of its own.

    Attributes:
        panels: from left to right; None leaves a column free.
        bar: the colour bar of the row.
    """

    panels: tuple[Panel | None, ...]
    bar: ColourBar | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of its pictures in pixels."""
        return next((panel.image.shape[0], panel.image.shape[1]) for panel in self.panels if panel is not None)

    @property
    def lines(self) -> int:
        """The most lines of text below a picture."""
        return max(len(panel.lines) for panel in self.panels if panel is not None)

    @property
    def free(self) -> int:
        """How many columns are free before the first picture."""
        return next(place for place, panel in enumerate(self.panels) if panel is not None)
