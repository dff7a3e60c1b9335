"""The caption of a figure, as plain text and with what LaTeX needs around it."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from meshfit.measuring.metrics import METRICS
from meshfit.report.figure import Strip
from meshfit.report.formats.latex import escape
from meshfit.report.picks import Pick
from meshfit.report.wording import FRAMES


def plain_caption(strips: Sequence[Strip], metric: str) -> str:
    """The caption as one paragraph.

    Args:
        strips: what the figure shows.
        metric: a name of `METRICS`, of which each result tells its value.
    """
    return " ".join(f"{sentence}." for sentence in _sentences(strips, metric)) + "\n"


def latex_figure(strips: Sequence[Strip], metric: str, file: str) -> str:
    r"""A figure over both columns, for a document with `\usepackage{graphicx}`.

    Args:
        strips: what the figure shows.
        metric: as for `plain_caption`.
        file: the name of the figure's file.
    """
    return "\n".join(
        [
            r"\begin{figure*}",
            r"  \centering",
            rf"  \includegraphics[width=\textwidth]{{{file}}}",
            rf"  \caption{{{escape(plain_caption(strips, metric).strip())}}}",
            rf"  \label{{fig:{''.join(letter if letter.isalnum() else '-' for letter in Path(file).stem)}}}",
            r"\end{figure*}",
            "",
        ]
    )


def _sentences(strips: Sequence[Strip], metric: str) -> Iterator[str]:
    title = METRICS[metric].title
    several = any(len(strip.sources) > 1 for strip in strips)
    source = "the source as each scheme refines it" if several else "the source"
    yield (
        f"{', '.join(_titles(strips))}: from left to right the target, {source}, and the result of each scheme with "
        f"its {title}"
    )
    yield from _seeds(strips, title)
    yield (
        "Below, the distance from each vert of a result to the target; the results of a row share one scale, which "
        "ends where 99 of 100 verts of each are nearer"
    )
    if metric.startswith("hausdorff."):
        yield "A Hausdorff distance can be larger, since it is looked for on all of the faces, and from the target too"
    yield "A ring marks the vert that is farthest off, a dashed one where it is out of sight"
    normalise = dict.fromkeys(str(strip.shown.settings.get("normalise")) for strip in strips)
    yield f"Lengths are in {'; '.join(FRAMES.get(name, name) for name in normalise)}"
    yield "All meshes of a target are seen from one side, and but for sources that would not fit, at one scale"
    if any(strip.hidden for strip in strips):
        yield "Only the first scheme's source is shown; those of the others differ"


def _seeds(strips: Sequence[Strip], title: str) -> Iterator[str]:
    counts = sorted({pick.seeds for strip in strips for pick in strip.shown.picks})
    if counts == [1]:
        yield f"One run each: {'; '.join(_listed(strips))}"
        return
    how_many = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    yield f"Of {how_many} seeds, the run with the median {title} is shown: {'; '.join(_listed(strips))}"


def _listed(strips: Sequence[Strip]) -> Iterator[str]:
    for strip in strips:
        yield f"{strip.shown.title}, {', '.join(map(_named, strip.shown.picks))}"


def _named(pick: Pick) -> str:
    return f"{pick.scheme} seed {pick.seed}"


def _titles(strips: Sequence[Strip]) -> list[str]:
    titles = [strip.shown.title for strip in strips]
    return [titles[0][:1].upper() + titles[0][1:], *titles[1:]]
