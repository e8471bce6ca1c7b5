"""From runs to times at given errors, ratios and the page."""

import numpy as np
import pytest

from reports.benchmark.reference import Reference
from reports.benchmark.samplers import (
    LEVELS,
    Measured,
    measured,
    time_cells,
    times_to,
    written,
)


def row(engine, size, warm, error, *, cold_more=10.0):
    cold = warm + cold_more
    return Measured("published", engine, size, 3, warm, cold, 2.0 * warm, error, 100.0, 1.0, None)


OURS = [row("percept", 0.1, 1.0, 0.02, cold_more=1.0),
        row("percept", 0.01, 4.0, 0.01, cold_more=1.0)]  # fmt: skip
NUTPIE = [row("nutpie", 250, 8.0, 0.2), row("nutpie", 1000, 30.0, 0.1)]


def test_times_to_an_error_are_measured_where_they_can_be():
    # Measured: the fastest run that was accurate enough.
    ours, was_measured = times_to(0.1, OURS)
    assert (ours.tolist(), was_measured) == ([1.0, 2.0, 2.0], True)
    assert times_to(0.1, NUTPIE)[0].tolist() == [30.0, 40.0, 60.0]
    # Beyond: time over error squared from the most accurate run; the start-up is paid once.
    assert times_to(0.005, OURS)[0] == pytest.approx([16.0, 17.0, 32.0], rel=1e-12)
    beyond, was_measured = times_to(0.02, NUTPIE)
    assert not was_measured
    assert beyond == pytest.approx([750.0, 760.0, 1500.0], rel=1e-12)
    assert dict(zip(LEVELS, time_cells(NUTPIE, OURS), strict=True))[0.02] == "*750 / 380 / 750*"


def test_losses_are_bold():
    slow = [row("percept", 0.01, 400.0, 0.01)]
    cells = dict(zip(LEVELS, time_cells(NUTPIE, slow), strict=True))
    assert cells[0.1] == "**0.075 / 0.0976 / 0.075**"
    assert not any(cell.startswith("**") for cell in time_cells(NUTPIE, OURS))


def run_at(size, seconds, off):
    """One whose limits are off by so many half-widths; its own error is a tenth of a half-width."""
    value = np.stack([np.full((2, 10), -1.0), np.full((2, 10), 1.0)], axis=1) + off
    error = np.full(value.shape, 0.1)
    told = {"processor": 2.0 * seconds, "effective": 50.0, "notes": {"divergences": 4.0}}
    return {"size": size, "seconds": seconds, "value": value, "error": error, **told}


def test_runs_are_reduced_by_budget():
    exact = run_at(0, 1.0, 0.0)["value"]
    reference = Reference(exact, np.zeros(exact.shape), 1.0)
    runs = [{"size": "cold", "seconds": 7.0}]
    runs += [run_at(250, 1.0, 0.3), run_at(250, 3.0, 0.4), run_at(1000, 5.0, 0.1)]
    small, large = measured("published", "nutpie", runs, reference)
    assert (small.repeats, small.warm, small.cold, small.processor) == (2, 2.0, 7.0, 4.0)
    assert small.error == pytest.approx(np.sqrt((0.3**2 + 0.4**2) / 2), rel=1e-12)
    assert small.agreement == pytest.approx(small.error / 0.1, rel=1e-12)
    assert (large.cold, large.effective, large.divergences) == (10.0, 10.0, 4.0)


def test_the_page_holds_everything():
    text = written({"published": {"percept": OURS, "nutpie": NUTPIE}}, ["stan"]).text
    assert "Not installed, and left out: stan." in text
    assert "- published: 10 subjects, 5 environments, one trial; k and b." in text
    assert "| published | percept | 1 / 2 / 2 | *1 /" not in text
    assert "| published | nutpie, written plainly | 30 / 20 / 30 |" in text
