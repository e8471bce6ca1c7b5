"""One-port passivity of direct rendering, in both models, against the conditions they come from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from percept.errors import UsageError
from percept.haptics import Device, Environment, passivity_damping, perceived_impedance

T = 1e-3
STIFFNESS = np.array([10.0, 1000.0, 10000.0, 25000.0, 50000.0])
DAMPING = np.array([0.1, 1.0, 10.0, 25.0, 50.0])


def test_published_environments():
    environment = Environment(STIFFNESS, DAMPING)
    colgate = passivity_damping(environment, T)
    assert [f"{value:.4g}" for value in colgate] == ["0.105", "1.5", "15", "37.5", "75"]
    tustin = passivity_damping(environment, T, model="tustin")
    assert [f"{value:.4g}" for value in tustin] == ["-0.095", "-0.5", "-5", "-12.5", "-25"]


def test_dropping_the_damping_is_wrong():
    # "K_max = 2B/T" leaves out |b|.
    assert passivity_damping(Environment(1000.0, 3.0), T) == pytest.approx(3.5)


def test_masses_alone_give_the_need_its_shape():
    need = passivity_damping(Environment(1000.0, 1.0, np.ones(3)), T, model="tustin")
    assert need.tolist() == [-0.5] * 3  # k·T/2 − b


value = st.one_of(st.just(0.0), st.floats(1e-2, 1e3))


@settings(max_examples=60, deadline=None)
@given(stretch=value, damping=value, inertia=value)
def test_colgate_and_schenkel_over_all_omega(stretch, damping, inertia):
    environment = Environment(stretch / T, damping, inertia * T)
    theta = np.linspace(1e-4, np.pi, 20_001)
    z = np.exp(1j * theta)
    step = (z - 1) / (T * z)
    force = stretch / T + damping * step + inertia * T * step**2
    asked = T / (2 * (1 - np.cos(theta))) * ((1 - 1 / z) * force).real
    need = passivity_damping(environment, T)
    assert need == pytest.approx(asked.max(), rel=1e-6, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(stretch=value, damping=value, inertia=value)
def test_own_model_is_where_the_real_part_stays_positive(stretch, damping, inertia):
    environment = Environment(stretch / T, damping, inertia * T)
    need = float(passivity_damping(environment, T, model="tustin"))
    omega = np.concatenate([[0.0], np.geomspace(1e-3, np.pi / T, 2001)])
    scale = 1 + stretch + damping
    enough = perceived_impedance(omega, Device(1.0, max(need, 0.0)), environment, T).real
    assert (enough >= -1e-14 * scale).all()
    if need > 1e-6:
        short = perceived_impedance(omega, Device(1.0, need * 0.999), environment, T).real
        assert short.min() < 0


def test_unknown_model_is_refused():
    with pytest.raises(UsageError, match="model must be one of 'colgate', 'tustin'"):
        passivity_damping(Environment(1.0, 1.0), T, model="minsky")
