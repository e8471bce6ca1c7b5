"""Cells, rows that pair, and adjustments as they are, against exact arithmetic."""

from fractions import Fraction

import pandas as pd
import pytest

from percept import Scene
from percept.results import CellValues, IntervalRow
from percept.sessions import Sessions
from percept.study.data import Data, what_was_read
from percept.study.intervals import method_pairs


def sessions_of(rows):
    columns = ["subject", "environment", "k_ref", "b_ref", "trial", "k_adj", "b_adj"]
    table = pd.DataFrame(rows, columns=columns)
    return Sessions.from_frame(table)


def values_of(sessions):
    return what_was_read(Data(sessions, Scene())).cells


def test_subjects_count_once_by_the_mean_of_their_trials():
    offset = 2.0**50
    rows = [
        ("2", "A", offset, 1.0, 1, offset + 1, 3.0),
        ("2", "A", offset, 1.0, 2, offset + 4, None),
        ("1", "A", offset, 1.0, 1, offset + 2, None),
        ("3", "A", offset, 1.0, 1, offset + 6, None),
        ("3", "B", 20.0, 2.0, 1, 7.0, None),
    ]
    found = {(one.environment, one.parameter): one for one in values_of(sessions_of(rows))}
    assert list(found) == [("B", "k"), ("B", "b"), ("A", "k"), ("A", "b")]
    stiff = found["A", "k"]
    assert stiff.values == (offset + 2.5, offset + 2, offset + 6)
    exact = [Fraction(value) for value in stiff.values]
    mean = sum(exact) / 3
    assert stiff.mean == float(mean)
    variance = sum((x - mean) ** 2 for x in exact) / 2
    assert stiff.sd == pytest.approx(float(variance) ** 0.5, rel=1e-15)
    assert (stiff.reference, stiff.n, stiff.unit) == (offset, 3, "N/m")
    assert found["A", "b"] == CellValues(
        environment="A", parameter="b", reference=1.0, n=1, mean=3.0, sd=None,
        values=found["A", "b"].values, unit="N·s/m",
    )  # fmt: skip
    empty = found["B", "b"]
    assert (empty.n, empty.mean, empty.values) == (0, None, ())


def test_equal_values_have_no_scatter_and_are_described():
    rows = [(s, "A", 10.0, 1.0, 1, 9.0, 1.5) for s in ("1", "2", "3")]
    found = values_of(sessions_of(rows))
    assert [(one.mean, one.sd) for one in found] == [(9.0, 0.0), (1.5, 0.0)]


def test_estimates_about_a_negative_reference_shift_in_their_unit():
    rows = [
        IntervalRow(
            environment="A", parameter=p, kind="mean", family="normal", joint="marginal",
            method=method, reference=reference, lower=estimate - 1.0, upper=estimate + 1.0,
            estimate=estimate, level=0.9, share=None, confidence=None, n=4, unit="", covers="",
        )
        for p, reference in (("k", -6.0), ("b", 6.0))
        for method, estimate in (("classical", -0.5), ("bayesian", 0.5))
    ]  # fmt: skip
    found = {pair.parameter: (pair.relative, pair.shift) for pair in method_pairs(rows)}
    assert found == {"k": (False, 1.0), "b": (True, -2.0)}
