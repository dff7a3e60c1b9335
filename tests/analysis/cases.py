"""Analyses shared by several tests, and which of them are quick enough for every run.

In the fast suite each domain is analysed by one scheme: interp-loop, catmull-clark and four-point. `make reproduce`
runs the others too.
"""

from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

import pytest

from meshfit.analysis.analyse import VALENCES, Analysis, analyse
from meshfit.subdivision.registry import resolve

FAST = ("interp-loop", "catmull-clark", "four-point")


@cache
def analysed(spec: str, valences: Sequence[int] = VALENCES) -> Analysis:
    """The analysis of a scheme, computed once."""
    return analyse(resolve(spec), valences)


def by_scheme(specs: Iterable[str], fast: Sequence[str] = FAST) -> Any:
    """Parametrise a test by scheme, all but the fast ones marked as slow."""
    return pytest.mark.parametrize(
        "spec", [spec if spec in fast else pytest.param(spec, marks=pytest.mark.slow) for spec in specs]
    )
