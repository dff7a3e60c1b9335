"""Traces: which steps have a row, its numbers, and lossless CSV."""

import csv
import io
from math import inf, isnan, nan, nextafter

import numpy as np
import pytest

from meshfit.fitting.problem import COLUMNS, Trace
from meshfit.mesh.solids import cube
from tests.fits import fit
from tests.loops import over
from tests.shapes import mixed_closed

TERMS = COLUMNS[2:-1]
DEFAULTS = {"chamfer": 1.0, "normal": 0.0, "edge": 1.0, "laplacian": 0.1, "consistency": 0.01}


def rows_of(**changes):
    return fit(mixed_closed(), cube(), **({"samples": 50, "device": "cpu"} | changes)).trace.rows


@pytest.mark.parametrize(
    ("steps", "every", "expected"),
    [
        (1, 10, [0]),
        (2, 10, [0, 1]),
        (10, 10, [0, 9]),
        (11, 10, [0, 10]),
        (12, 10, [0, 10, 11]),
        (7, 3, [0, 3, 6]),
        (8, 3, [0, 3, 6, 7]),
        (4, 1, [0, 1, 2, 3]),
        (0, 5, []),
    ],
)
def test_the_first_and_the_last_step_and_every_nth_have_a_row(steps, every, expected):
    assert [row[0] for row in rows_of(steps=steps, trace_every=every)] == expected


@pytest.mark.parametrize("weights", [{}, {"normal": 0.3, "edge": 0}, {"chamfer": 0}, {"laplacian": 2.5, "normal": 1}])
@over("dtype", ["float32", "float64"])
def test_the_loss_is_the_weighted_sum_of_the_terms(weights, dtype):
    for row in rows_of(steps=4, trace_every=1, losses=weights, dtype=dtype):
        values = dict(zip(TERMS, row[2:-1], strict=True))
        weighted = sum(weight * values[name] for name, weight in (DEFAULTS | weights).items())
        assert row[1] == pytest.approx(weighted, rel=1e-6 if dtype == "float32" else 1e-14)


@pytest.mark.parametrize("silent", TERMS)
def test_a_term_of_weight_0_is_traced_like_any_other(silent):
    weighted = rows_of(steps=1, losses=dict.fromkeys(TERMS, 1.0), dtype="float64")
    without = rows_of(steps=1, losses=dict.fromkeys(TERMS, 1.0) | {silent: 0.0}, dtype="float64")
    assert without[0][2:] == weighted[0][2:]
    assert without[0][1] < weighted[0][1]


def test_how_often_rows_are_written_does_not_change_them():
    every, sparse = rows_of(steps=9, trace_every=1), rows_of(steps=9, trace_every=4)
    assert sparse == [every[step] for step in (0, 4, 8)]


def test_the_csv_reads_back_to_the_same_doubles():
    generator = np.random.default_rng(0)
    trace = Trace()
    numbers = generator.normal(size=(50, 7)) * 10.0 ** generator.integers(-300, 300, size=(50, 7))
    for step, values in enumerate(numbers.tolist()):
        trace.append(step, values[0], dict(zip(TERMS, values[1:6], strict=True)), values[6])
    extremes = dict(zip(TERMS, (5e-324, nextafter(1, 2), 1 / 3, -0.0, inf), strict=True))
    trace.append(50, 1.7976931348623157e308, extremes, nan)
    table = list(csv.reader(io.StringIO(trace.to_csv())))
    assert tuple(table[0]) == COLUMNS
    assert [int(line[0]) for line in table[1:]] == list(range(51))
    for line, row in zip(table[1:], trace.rows, strict=True):
        for text, value in zip(line[1:], row[1:], strict=True):
            assert float(text).hex() == value.hex() or (isnan(value) and isnan(float(text)))


def test_the_csv_of_a_fit_reads_back_to_its_rows():
    trace = fit(mixed_closed(), cube(), steps=12, samples=50, device="cpu").trace
    table = list(csv.reader(io.StringIO(trace.to_csv())))[1:]
    assert [tuple(map(float, line)) for line in table] == trace.rows


def test_terms_are_written_in_the_order_of_the_columns_however_they_come():
    trace = Trace()
    trace.append(3, 0.5, dict(reversed([(name, float(i)) for i, name in enumerate(TERMS)])), 1.0)
    assert trace.to_csv() == ("step,loss,chamfer,normal,edge,laplacian,consistency,lr\n3,0.5,0.0,1.0,2.0,3.0,4.0,1.0\n")


def test_an_empty_trace_is_a_header():
    assert Trace().to_csv() == ",".join(COLUMNS) + "\n"
