"""DC, Nyquist and beyond: true limits, conjugates, refusals, and never NaN."""

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Loop,
    Mode,
    absolute_stability,
    coupling_impedance,
    device_impedance,
    effective_impedance,
    environment_impedance,
    hold,
    magnitude_envelope,
    max_coupling_stiffness,
    perceived_impedance,
    required_damping,
    required_damping_at,
    stability_margin,
)
from percept.haptics.arrays import complex_from
from percept.haptics.envelope import Ellipse, magnitude_envelope_ellipse
from percept.haptics.impedance import coupling_admittance
from percept.haptics.perceived import perceived_magnitude
from reports.benchmark import twins as twin
from tests import LONG

NYQUIST = np.pi / 1e-3
LOOP = Loop(Device(0.0, 0.0), 1e-3)


def near(values, theta):
    """The one-sided limit in high precision."""
    with mpmath.workdps(twin.DIGITS):
        period = mpmath.mpf(values["period"])
        numbers = {key: mpmath.mpf(value) for key, value in values.items()}
        numbers["omega"] = (
            mpmath.mpf(theta) if theta else mpmath.pi - mpmath.mpf("1e-25")
        ) / period
        return {
            name: complex(formula(twin._point(numbers, mpmath)))
            for name, formula in {
                "eff": twin.effective,
                "vc": twin.coupled,
                "h": twin.direct,
            }.items()
        }


def in_series(omega, environment, coupling, period):
    """Z_eff of the stiffness and damping shown."""
    stiffness, damping = effective_impedance(
        Loop(Device(0.0, 0.0), period), omega, environment, coupling
    )
    return complex_from(damping, Loop(Device(0.0, 0.0), period).at(omega).spring(stiffness))


ZERO_PATTERNS = [
    {},
    {"k_c": 0.0},
    {"k_e": 0.0},
    {"k_e": 0.0, "k_c": 0.0},
    {"m_e": 0.0},
    {"m_e": 0.0, "b_e": 0.0},
    {"m_e": 0.0, "b_e": 0.0, "b_c": 0.0},
    {"k_e": 0.0, "b_e": 0.0},
    {"k_c": 0.0, "b_c": 0.0},
    {"k_e": 0.0, "b_e": 0.0, "m_e": 0.0},
    {"b_e": 0.0, "b_c": 0.0},
]


@pytest.mark.parametrize("zeros", ZERO_PATTERNS, ids=lambda zeros: "+".join(zeros) or "none")
@pytest.mark.parametrize("end", ["dc", "nyquist"])
def test_coupled_forms_have_their_limits_whatever_is_absent(zeros, end):
    values = {
        "period": 1e-3,
        "m": 0.0,
        "b_d": 5.0,
        "k_e": 1000.0,
        "b_e": 2.0,
        "m_e": 0.3,
        "k_c": 5e4,
        "b_c": 80.0,
    }
    values |= zeros
    limit = near(values, "1e-25" if end == "dc" else None)
    omega = 0.0 if end == "dc" else NYQUIST
    environment = Environment(values["k_e"], values["b_e"], values["m_e"])
    coupling = Coupling(values["k_c"], values["b_c"])
    device = Device(values["m"], values["b_d"])
    ours = {
        "eff": in_series(omega, environment, coupling, 1e-3),
        "vc": perceived_impedance(Loop(device, 1e-3), omega, environment, coupling=coupling),
        "h": perceived_impedance(Loop(device, 1e-3), omega, environment),
    }
    for name, value in ours.items():
        for part, expected in ((value.real, limit[name].real), (value.imag, limit[name].imag)):
            if abs(expected) > 1e20:
                assert part == np.copysign(np.inf, expected), name
            else:
                assert part == pytest.approx(expected, rel=1e-13, abs=1e-18), name


def test_beside_an_undamped_resonance_the_stiffness_is_that_of_springs_in_series():
    """k₁k₂/(k₁ + k₂), k₁ = k − mΩ², is huge a few ulp from the pole too, and never cancels."""
    period = 1e-3
    environment, coupling = Environment(1000.0, 0.0, mass=0.5), Coupling(5000.0, 0.0)
    pole = 2 / period * np.arctan(np.sqrt(6000 / 0.5) * period / 2)
    omega = pole + np.arange(-2000, 2001) * np.spacing(pole)
    found, _ = effective_impedance(Loop(Device(0.0, 0.0), period), omega, environment, coupling)
    rate = 2 / period * np.tan(omega * period / 2)
    own = 1000.0 - 0.5 * rate**2
    with np.errstate(divide="ignore"):
        series = own * 5000.0 / (own + 5000.0)
    # An ulp of ω moves the denominator by some 1e-12 of 5000; what is seen of it moves by a few.
    far = np.abs(own + 5000.0) > 1e-9
    np.testing.assert_allclose(found[far], series[far], rtol=1e-2)
    assert np.abs(found).min() > 1e15


def test_nyquist_is_a_few_ulp_wide_and_a_hard_wall():
    device = Device(1.0, 5.0)
    for ulps in (-4, -1, 0, 1):
        omega = np.pi + ulps * np.spacing(np.pi)
        assert device_impedance(Loop(device, 1.0), omega).imag == np.inf
    below = np.pi - 6 * np.spacing(np.pi)
    assert np.isfinite(device_impedance(Loop(device, 1.0), below))
    for beyond in (np.pi + 6 * np.spacing(np.pi), -4.0):
        with pytest.raises(
            UsageError,
            match=r"omega is above the Nyquist frequency, 3\.14.* rad/s at a period of 1 s",
        ):
            device_impedance(Loop(device, 1.0), beyond)


@pytest.mark.parametrize("period", [0.0, -1e-3, np.nan, np.inf, [1e-3, 2e-3], "1 ms"])
def test_period_is_one_positive_number(period):
    with pytest.raises(UsageError, match="period must be"):
        device_impedance(Loop(Device(1.0, 5.0), period), 1.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: hold(LOOP, np.nan), "omega must be finite"),
        (
            lambda: hold(Loop(Device(0.0, 0.0), 1e-3, "zoh"), 1.0),
            "hold must be one of 'average', 'true'",
        ),
        (
            lambda: coupling_impedance(LOOP, 1.0, Coupling(1, 1), discretization="euler"),
            "discretization must be one of 'tustin', 'backward'",
        ),
        (
            lambda: perceived_magnitude(Loop(Device(1, 1), 1e-3), 1.0, np.nan, 0.0),
            "stiffness must be finite",
        ),
        (
            lambda: perceived_magnitude(Loop(Device(1, 1), 1e-3), 1.0, -np.inf, 0.0),
            r"stiffness must be finite and at most 1e\+100",
        ),
        (
            lambda: perceived_magnitude(Loop(Device(1, 1), 1e-3), 1.0, -1e101, 0.0),
            r"stiffness must be finite and at most 1e\+100",
        ),
    ],
)
def test_wrong_arguments_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()


parameter = st.one_of(st.just(0.0), st.floats(1e-15, 1e15))


@pytest.mark.evidence(reduced=True)
@settings(max_examples=150 if LONG else 60, deadline=None)
@given(
    log_period=st.floats(-6, 0),
    place=st.one_of(
        st.sampled_from([0.0, 1.0]), st.floats(0, 1), st.floats(-15, 0).map(lambda e: 10**e)
    ),
    p=st.lists(parameter, min_size=10, max_size=10),
    kind=st.sampled_from(["average", "true"]),
    discretization=st.sampled_from(["tustin", "backward"]),
)
def test_never_nan_and_negative_omega_is_the_conjugate(log_period, place, p, kind, discretization):
    period = 10**log_period
    omega = np.pi / period * place
    loop = Loop(Device(p[0], p[1], (Mode(p[2], p[3], p[4]),)), period, kind)
    environment, coupling = Environment(p[5], p[6], p[7]), Coupling(p[8], p[9])
    options = {"discretization": discretization}

    def complex_values(omega):
        return [
            device_impedance(loop, omega),
            environment_impedance(loop, omega, environment),
            coupling_impedance(loop, omega, coupling, **options),
            coupling_admittance(loop, omega, coupling, **options),
            perceived_impedance(loop, omega, environment),
            perceived_impedance(loop, omega, environment, coupling=coupling, **options),
        ]

    values = complex_values(omega)
    assert not np.isnan(values).any()
    if omega:
        np.testing.assert_array_equal(complex_values(-omega), np.conj(values))
    box = (-p[5], p[8]), (-p[6], p[9])
    shape = [[p[5] ** 2, 0.0], [0.0, p[6] ** 2]]
    need = required_damping(loop, coupling, **options)
    rigid = Loop(Device(0.0, p[1]), period, kind)
    numbers = [
        perceived_magnitude(loop, omega, -p[5], p[6], mass=p[7]),
        *magnitude_envelope(loop, omega, *box, mass=p[7]),
        *magnitude_envelope_ellipse(loop, omega, Ellipse((p[8], p[9]), shape, 1.5)),
        required_damping_at(loop, omega, coupling, **options),
        stability_margin(loop, omega, coupling, **options),
        need.damping,
        need.omega,
        max_coupling_stiffness(rigid, p[9], **options),
        absolute_stability(loop, coupling, **options).smallest_margin,
    ]
    assert not np.isnan(numbers).any()
