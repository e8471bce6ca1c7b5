from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.ticker import LogLocator, MaxNLocator

from percept.report.figures.svg.ticks import linear_ticks, log_ticks, minor_ticks

STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


@given(st.floats(-1e5, 1e5), st.floats(1e-3, 1e5), st.integers(2, 12))
def test_linear_ticks_are_even_round_and_inside(low, span, most):
    high = low + span
    places, labels = linear_ticks(low, high, most=most)
    step = min(np.diff(places)) if len(places) > 1 else span
    assert len(places) <= most + 1
    assert all(low - 1e-6 * span <= place <= high + 1e-6 * span for place in places)
    if len(places) > 1:
        np.testing.assert_allclose(np.diff(places), step, rtol=1e-6)
        leading = step / 10.0 ** np.floor(np.log10(step) + 1e-9)
        assert min(abs(leading - one) for one in STEPS) < 1e-6
    for place, label in zip(places, labels, strict=True):
        assert abs(float(label) - place) <= 1e-6 * span


@pytest.mark.parametrize(
    ("low", "high", "most"),
    [(0.0, 53.0, 6), (9.6, 10.5, 5), (9.89, 10.11, 5), (-3.0, 3.0, 7), (0.95, 1.87, 5)],
)
def test_linear_ticks_are_matplotlib_s(low, high, most):
    theirs = MaxNLocator(nbins=most, steps=list(STEPS)).tick_values(low, high)
    inside = theirs[(theirs >= low - 1e-9) & (theirs <= high + 1e-9)]
    np.testing.assert_allclose(linear_ticks(low, high, most=most)[0], inside, atol=1e-12)


def test_labels_have_the_decimals_of_the_step():
    assert linear_ticks(0.0, 1.0, most=4)[1] == ["0.00", "0.25", "0.50", "0.75", "1.00"]
    assert linear_ticks(-20.0, 20.0, most=4)[1] == ["-20", "-10", "0", "10", "20"]
    assert linear_ticks(0.0, 4e6, most=4)[1] == ["0", "1e+06", "2e+06", "3e+06", "4e+06"]


@given(st.floats(1e-12, 1e9), st.floats(1.5, 1e12), st.integers(2, 9))
def test_log_ticks_are_inside_and_few(low, ratio, most):
    places, labels = log_ticks(low, low * ratio, most=most)
    assert 1 <= len(places) == len(labels)
    assert len(places) <= max(most + 1, 6)
    assert all(low * (1 - 1e-6) <= place <= low * ratio * (1 + 1e-6) for place in places)


def test_powers_of_ten_and_their_labels():
    assert log_ticks(0.1, 100.0, most=9) == (
        [0.1, 1.0, 10.0, 100.0],
        ["10$^{-1}$", "10$^{0}$", "10$^{1}$", "10$^{2}$"],
    )
    assert log_ticks(0.1, 100.0, most=9, label="{:g}".format)[1] == ["0.1", "1", "10", "100"]
    assert log_ticks(1e-8, 1e8, most=6)[0] == pytest.approx([1e-8, 1e-5, 1e-2, 1e1, 1e4, 1e7])


def test_where_powers_of_ten_are_few_others_stand():
    assert log_ticks(0.9, 9.0, most=9) == ([1.0, 2.0, 5.0], ["1", "2", "5"])
    assert log_ticks(0.93, 1.04, most=3)[0] == pytest.approx([0.95, 1.0])


def test_ticks_between_are_matplotlib_s():
    low, high = 0.3, 4000.0
    theirs = LogLocator(subs=range(2, 10), numticks=99).tick_values(low, high)
    inside = theirs[(theirs >= low) & (theirs <= high)]
    np.testing.assert_allclose(minor_ticks(low, high, log_ticks(low, high, most=9)[0]), inside)
    assert minor_ticks(1e-8, 1e8, log_ticks(1e-8, 1e8, most=6)[0]) == []
    assert minor_ticks(0.9, 9.0, [1.0, 2.0, 5.0]) == []
