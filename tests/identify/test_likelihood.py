"""The likelihood of a device against slower forms of the same, and its impedance against mpmath."""

import numpy as np
import pytest
from mpmath import mp, mpc, mpf
from scipy import optimize

from percept.identify.density import DeviceDensity
from percept.identify.model import DeviceModel, Terms
from percept.identify.spectra import Periods
from tests.identify.simulated import Recording, simulate

ALL = Terms(modes=1, spring=True, delay=True, friction=True)
VALUES = [1.0, 5.0, 300.0, 2e-3, 0.8, 0.2, 8e3, 2.0]
RECORDING = Recording(length=64, periods=6, highest=1200.0)


@pytest.fixture(scope="module")
def periods():
    log = simulate(ALL, VALUES, np.random.default_rng(4), RECORDING)
    return Periods.of(log, RECORDING.period, RECORDING.band)


def test_impedance_is_that_of_fifty_digits():
    omega = np.geomspace(1e-3, 1e5, 30)
    impedance = DeviceModel(ALL).impedance(np.log([VALUES]), omega)[0]
    with mp.workdps(50):
        for value, at in zip(impedance, omega, strict=True):
            m, b, k, _, _, mode, stiffness, damping = [mp.exp(mpf(np.log(v))) for v in VALUES]
            s = mpc(0, mpf(at))
            joint = damping * s + stiffness
            exact = m * s + b + k / s + mode * s * joint / (mode * s**2 + joint)
            assert abs(mpc(value) - exact) <= 1e-12 * abs(exact)


def test_likelihood_is_that_of_the_best_means_and_covariances(periods):
    """-R log det of the best covariance, minimized over the mean velocity by hand."""
    model = DeviceModel(ALL)
    density = DeviceDensity(model, periods.spectra(), ALL.parameters)
    point = np.log(VALUES) + 0.01
    t = density.standardized(point[None])[0]
    given = dict(zip(model.names, np.exp(point), strict=True))
    impedance = model.impedance(point[None], periods.omega)[0]
    for line, omega in enumerate(periods.omega):
        force, velocity = periods.force[line], periods.velocity[line]
        lag = np.exp(-1j * omega * given["delay"])

        def log_det(real_and_imaginary, velocity=velocity, force=force, line=line, lag=lag):
            mean = complex(*real_and_imaginary)
            friction = given["coulomb"] * periods.sign[line]
            rows = [force - lag * (impedance[line] * mean + friction), velocity - mean]
            scatter = np.array(rows) @ np.conj(rows).T
            return float(np.log(np.linalg.det(scatter).real))

        # The predicted friction does not follow the mean velocity: its sign is known.
        rows = np.array([force - force.mean(), velocity - velocity.mean()])
        least = np.log(np.linalg.det(rows @ rows.conj().T).real)
        start = [velocity.mean().real, velocity.mean().imag]
        best = optimize.minimize(
            log_det, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-11}
        )
        assert best.fun - least == pytest.approx(np.log1p(abs(t[line]) ** 2), rel=1e-5, abs=1e-7)


def test_residuals_are_the_square_root_of_the_density(periods):
    density = DeviceDensity(DeviceModel(ALL), periods.spectra(), ALL.parameters)
    for shift in (0.0, 0.1, -1.0):
        point = np.log(VALUES) + shift
        squares = np.sum(density.residuals(point) ** 2)
        assert density(point[None])[0] == pytest.approx(-0.5 * squares, rel=1e-12)


def test_the_slope_varies_as_the_curvature_says():
    """What the power R - 1 is for: of the power R the ratio is R/(R - 1)."""
    terms, truth = Terms(), np.log([1.0, 5.0])
    recording = Recording(length=128, periods=5)
    slopes, curvatures = [], []
    step = 1e-3
    for seed in range(400):
        log = simulate(terms, np.exp(truth), np.random.default_rng([seed, 6]), recording)
        spectra = Periods.of(log, recording.period, recording.band).spectra()
        density = DeviceDensity(DeviceModel(terms), spectra, terms.parameters)
        around = truth + np.array([[0.0, 0.0], [0.0, step], [0.0, -step]])
        middle, above, below = density(around)
        slopes.append((above - below) / (2.0 * step))
        curvatures.append((2.0 * middle - above - below) / step**2)
    ratio = np.var(slopes) / np.mean(curvatures)
    assert abs(ratio - 1.0) < 4.0 * np.sqrt(2.0 / len(slopes))


def test_far_away_the_density_is_zero_and_never_nan(periods):
    density = DeviceDensity(DeviceModel(ALL), periods.spectra(), ALL.parameters)
    values = density(np.vstack([np.full(8, 400.0), np.full(8, -400.0), np.log(VALUES)]))
    assert not np.isnan(values).any()
    assert values[2] > values[1]
