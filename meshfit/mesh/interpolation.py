"""Interpolation of attributes: each row of the result is a weighted sum of rows, as far as its type allows."""

import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from meshfit.mesh.attributes import COLOR, JOINTS, WEIGHTS, Values
from meshfit.mesh.topology import Indices

Operators = Sequence[csr_array]
"""Sparse operators, applied one after the other; their rows sum to one."""

_COLOR = re.compile(rf"{COLOR}\d*")


def interpolated_rows(rows: Mapping[str, Values], operators: Operators) -> dict[str, Values]:
    """Return the data of the vertices, or of the corners, that some operators lead to; types and names stay.

    Floats are weighted sums. Colours are, too; they are clipped, as weights may be negative, and rounded if they are
    integers. All other integers are labels, and taken from the row with the largest weight. The skin (joints, weights)
    is summed joint by joint; of the sums, the largest are kept, as many as there were, and add up to one.

    Args:
        rows: data by name, each with one row for each column of the first operator.
        operators: none leave everything as it is.
    """
    if not operators:
        return dict(rows)
    fine = {name: interpolated(name, values, operators) for name, values in rows.items()}
    if JOINTS in rows and WEIGHTS in rows:
        fine[JOINTS], fine[WEIGHTS] = _skin(rows[JOINTS], rows[WEIGHTS], operators)
    return fine


def interpolated(name: str, values: Values, operators: Operators) -> Values:
    """Return the rows that some operators lead to, as `interpolated_rows` does for one name."""
    is_color = _COLOR.fullmatch(name) is not None
    if not (is_color or np.issubdtype(values.dtype, np.floating)):
        return np.asarray(values[strongest_columns(operators)])
    fine = values.reshape(len(values), -1).astype(np.float64)
    for operator in operators:
        fine = operator @ fine
    if is_color:
        if np.issubdtype(values.dtype, np.floating):
            fine = fine.clip(min(0.0, values.min(initial=0.0)), max(1.0, values.max(initial=1.0)))
        else:
            fine = np.rint(fine).clip(0, np.iinfo(values.dtype).max)
    return np.asarray(fine.astype(values.dtype).reshape(-1, *values.shape[1:]))


def strongest_columns(operators: Operators) -> Indices:
    """Return the column with the largest weight in each row of the product; of equal ones, the first."""
    product = operators[0]
    for operator in operators[1:]:
        product = operator @ product
    entries = coo_array(product)
    order = np.lexsort((entries.col, -entries.data.round(12), entries.row))
    rows, first = np.unique(entries.row[order], return_index=True)
    columns = np.zeros(product.shape[0], dtype=np.int64)
    columns[rows] = entries.col[order][first]
    return columns


def _skin(joints: Values, weights: Values, operators: Operators) -> tuple[Values, Values]:
    """Return the joints of each row, the strongest first, and their weights."""
    count = joints.shape[1]
    rows = np.repeat(np.arange(len(joints)), count)
    columns = joints.reshape(-1).astype(np.int64)
    shape = (len(joints), int(columns.max(initial=0)) + 1)
    matrix = csr_array(coo_array((weights.reshape(-1).astype(np.float64), (rows, columns)), shape=shape))
    for operator in operators:
        matrix = csr_array(operator @ matrix)
    row, column, share = _largest(coo_array(matrix), count)
    place = np.arange(len(row)) - np.searchsorted(row, row)
    chosen = np.zeros((matrix.shape[0], count), dtype=joints.dtype)
    shares = np.zeros((matrix.shape[0], count))
    chosen[row, place], shares[row, place] = column, share
    total = shares.sum(axis=1, keepdims=True)
    shares = np.divide(shares, total, out=shares, where=total > 0)
    if np.issubdtype(weights.dtype, np.floating):
        return chosen, shares.astype(weights.dtype)
    return chosen, np.rint(shares * np.iinfo(weights.dtype).max).astype(weights.dtype)


def _largest(entries: coo_array, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return row, column and value of the largest positive entries of each row, in order of rows, largest first."""
    order = np.lexsort((entries.col, -entries.data, entries.row))
    order = order[entries.data[order] > 0]
    row = entries.row[order].astype(np.int64)
    order = order[np.arange(len(row)) - np.searchsorted(row, row) < count]
    return entries.row[order].astype(np.int64), entries.col[order].astype(np.int64), entries.data[order]


def barycentric_operator(
    faces: Int64[np.ndarray, "N 3"], weights: Float64[np.ndarray, "N 3"], num_columns: int
) -> csr_array:
    """Return the (N, num_columns) operator to points within triangles.

    Args:
        faces: (N, 3) the columns of the corners of the triangle of each point.
        weights: (N, 3) its barycentric coordinates.
        num_columns: number of rows of the data.
    """
    rows = np.repeat(np.arange(len(faces)), 3)
    shape = (len(faces), num_columns)
    return csr_array(coo_array((weights.reshape(-1), (rows, faces.reshape(-1))), shape=shape))
