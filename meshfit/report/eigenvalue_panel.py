"""The chart of the leading eigenvalues over the valences."""

from typing import Any

from meshfit.report.colours import INK
from meshfit.subdivision.analysis.analyse import Analysis

# Blue and vermilion of Okabe and Ito (2008), which the colour-blind can tell apart; shapes differ too.
_LEADING, _REST, _SQUARE = "#0072b2", "#d55e00", "#7d8a96"
_FAILING = "#eceff2"


def draw_eigenvalues(axes: Any, analysis: Analysis, font: float) -> None:  # noqa: ANN401  matplotlib is optional
    """λ1, the largest other eigenvalue and λ1² at each valence; where C1 fails the ground is grey."""
    valences = [place.valence for place in analysis.places]
    leading = [place.spectrum.leading.modulus for place in analysis.places]
    rest = [place.spectrum.rest.modulus for place in analysis.places]
    for valence in analysis.failing:
        axes.axvspan(valence - 0.5, valence + 0.5, color=_FAILING, linewidth=0, zorder=0)
    square = [value**2 for value in leading]
    style = {"linewidth": 0.9, "markersize": 4, "markeredgewidth": 0.8}
    axes.plot(valences, leading, color=_LEADING, marker="o", label="λ1, of mode 1", zorder=4, **style)
    axes.plot(
        valences, rest, color=_REST, marker="s", markerfacecolor="white", label="largest other", zorder=3, **style
    )
    axes.plot(valences, square, color=_SQUARE, linewidth=0.8, linestyle=(0, (4, 2)), label="λ1²", zorder=2)
    axes.set_xlim(valences[0] - 0.6, valences[-1] + 0.6)
    axes.set_ylim(0, 1.28 * max(*leading, *rest))
    axes.set_xticks(valences)
    axes.tick_params(labelsize=font, length=2, width=0.5, colors=INK)
    axes.set_xlabel("corners of the face" if analysis.odd == "face" else "valence", fontsize=font, color=INK)
    axes.set_ylabel("modulus of eigenvalues", fontsize=font, color=INK)
    if analysis.failing:
        axes.fill_between([], [], facecolor=_FAILING, edgecolor=_SQUARE, linewidth=0.4, label="not C1")
    axes.legend(
        loc="upper left",
        ncols=2,
        fontsize=font,
        frameon=False,
        labelcolor=INK,
        handlelength=1.8,
        columnspacing=1.2,
        borderaxespad=0.1,
    )
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
