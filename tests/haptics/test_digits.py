"""Every function against the textbook formula in 120 digits, within 1e-13 times its condition."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from percept.haptics import Coupling, Device, Loop, required_damping_at
from reports.benchmark import twins as twin
from reports.benchmark.digits_haptics import PROMISE, QUANTITIES, Inputs, error_of, haptics_digits
from tests import LONG

CASES = 1000 if LONG else 30
# Tests over more cases in `make evidence`.
REDUCED = pytest.mark.evidence(reduced=True)


@pytest.fixture(scope="module")
def sweep():
    return haptics_digits(CASES)


@REDUCED
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_promise_is_kept(sweep, quantity):
    rows = [row for row in sweep if row.quantity == quantity]
    assert sum(row.cases for row in rows) == CASES
    worst = max(rows, key=lambda row: row.over_promise)
    assert worst.over_promise <= 1, worst


parameter = st.one_of(st.just(0.0), st.floats(-15, 15).map(lambda e: 10.0**e), st.floats(0.5, 50))
NAMES = ("m", "b_d", "k_e", "b_e", "m_e", "k_c", "b_c", "m_i", "b_i", "k_i", "k_d")


@REDUCED
@settings(max_examples=500 if LONG else 8, deadline=None)
@given(
    log_period=st.floats(-6, 0),
    share=st.one_of(st.just(1.0), st.floats(0, 1), st.floats(-15, -1e-3).map(lambda e: 10**e)),
    parameters=st.tuples(*[parameter] * len(NAMES)),
    delay=st.one_of(st.integers(0, 4).map(float), st.floats(1e-6, 20.0)),
)
def test_promise_is_kept_where_hypothesis_looks(log_period, share, parameters, delay):
    period = 10**log_period
    omega = max(np.pi / period * share, 1e-9)
    inputs = Inputs(omega, period, **dict(zip(NAMES, parameters, strict=True)), delay=delay)
    for quantity in QUANTITIES:
        assert error_of(quantity, inputs) <= PROMISE, quantity


def test_sweep_reaches_nyquist_and_low_frequency(sweep):
    decades = {row.at for row in sweep}
    assert 1 in decades
    assert min(decades) <= -7


def test_plain_complex_arithmetic_would_be_caught():
    # Eqs 6, 8 and 10 as they are written lose everything at low ω; the comparison must say so.
    values = {"omega": 1e-6, "period": 1e-3, "k_c": 110e3, "b_c": 100.0}
    z = np.exp(1j * values["omega"] * values["period"])
    z_c = values["b_c"] + values["k_c"] * values["period"] * z / (z - 1)
    zoh = (z + 1) / (2 * z)
    naive = (1 - np.cos(np.angle(zoh))) * abs(zoh) / (2 * (1 / z_c).real)
    exact = twin.required_at(twin.coupling_backward, twin.hold_average)
    assert twin.error_over_condition(naive, exact, values) > 0.1
    ours = required_damping_at(
        Loop(Device(0.0, 0.0), 1e-3), values["omega"], Coupling(110e3, 100.0)
    )
    assert twin.error_over_condition(float(ours), exact, values) < 1e-15
    assert f"{float(ours):.15g}" == "4.87903225806452"
    assert float(ours) == pytest.approx(4.879032258064516, rel=1e-15)
