"""The masks of a scheme on curves as people write them, read off the operator that they were laid down as."""

from collections.abc import Iterator

import numpy as np

from meshfit.mesh.curves import Chains
from meshfit.subdivision.curve_assemble import assemble_curves
from meshfit.subdivision.curve_scheme import CurveScheme
from meshfit.subdivision.mask_rows import MaskRow, along, push_back_row

_LENGTH = 12
_AT = 5


def describe_curves(scheme: CurveScheme) -> Iterator[MaskRow]:
    """Inside a curve, and at the start of an open one; the other end is its mirror image."""
    chain = Chains(_LENGTH, np.arange(_LENGTH), np.array([_LENGTH]), np.array([False]))
    rows, inserted = assemble_curves(chain, scheme), len(scheme.mask.inserted)
    yield MaskRow("old vertex", along(rows, _AT, _AT))
    places = {"inside": _AT, "in an end segment": 0}
    for where, segment in places.items():
        for i in range(inserted):
            which = "new vertex" if inserted == 1 else f"new vertex {i + 1} of {inserted}"
            yield MaskRow(f"{which}, {where}", along(rows, _LENGTH + inserted * segment + i, segment))
    yield MaskRow("end of an open curve", along(rows, 0, 0))
    if scheme.push_back is not None:
        yield push_back_row(scheme.push_back)
