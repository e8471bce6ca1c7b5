from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from percept.boundary.draws import MEMORY, DrawCurves, pointwise_band, relative_error
from percept.errors import UsageError
from percept.haptics import Device, Environment, perceived_impedance

DEVICE, PERIOD = Device(1.0, 5.0), 1e-3
OMEGA = np.geomspace(0.1, 100.0, 37)


def drawn(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    z = rng.standard_normal((2, count))
    return np.exp(9.2 + 0.05 * z[0]), np.exp(2.3 + 0.2 * (0.5 * z[0] + np.sqrt(0.75) * z[1]))


def slow_curves(k: np.ndarray, b: np.ndarray) -> np.ndarray:
    """One draw after the other, in complex numbers, in the same order."""
    return np.array(
        [
            np.abs(perceived_impedance(OMEGA, DEVICE, Environment(*pair), PERIOD))
            for pair in zip(k, b, strict=True)
        ]
    )


@pytest.mark.parametrize("count", [2, 3, 10, 401])
@pytest.mark.parametrize("level", [0.3, 0.9, 0.99])
def test_bands_equal_the_slow_twin(count: int, level: float) -> None:
    k, b = drawn(count, 1)
    curves = slow_curves(k, b)
    tails = [0.5 * (1.0 - level), 0.5 * (1.0 + level)]
    np.testing.assert_allclose(
        pointwise_band(OMEGA, DEVICE, k, b, PERIOD, level=level),
        np.quantile(curves, tails, axis=0),
        rtol=1e-13,
    )


def test_sd_of_few_draws_is_that_of_a_sample() -> None:
    k, b = drawn(5, 8)
    logs = np.log(slow_curves(k, b))
    curves = DrawCurves(DEVICE, k, b, PERIOD, level=0.9)
    # Logarithms of a few hundred are good to 1e-15, deviations of some hundredths to 1e-13.
    np.testing.assert_allclose(curves.at(OMEGA).sd, logs.std(axis=0, ddof=1), rtol=1e-11)


def test_error_is_half_the_distance_of_two_halves() -> None:
    k, b = drawn(400, 9)
    halves = [
        np.log(pointwise_band(OMEGA, DEVICE, k[part], b[part], PERIOD, level=0.9))
        for part in (slice(200), slice(200, None))
    ]
    bands = DrawCurves(DEVICE, k, b, PERIOD, level=0.9).at(OMEGA)
    np.testing.assert_allclose(bands.error, 0.5 * np.abs(halves[0] - halves[1]), rtol=1e-9, atol=1e-15)


def test_stated_error_is_the_scatter_between_sets_of_draws() -> None:
    omega = np.array([1.0, 30.0])
    found = [DrawCurves(DEVICE, *drawn(1000, seed), PERIOD, level=0.9).at(omega) for seed in range(400)]
    scatter = np.log([(bands.lower, bands.upper) for bands in found]).std(axis=0, ddof=1)
    stated = np.sqrt(np.mean([bands.error**2 for bands in found], axis=0))
    # Each of the two rests on 400 normals, and so has a relative standard error of 1 / sqrt(800).
    assert np.abs(stated / scatter - 1.0).max() < 4 * np.sqrt(2 / 800)


def test_relative_error_is_a_mean_over_log_omega_in_half_widths() -> None:
    omega = np.array([1.0, 10.0, 1000.0, 2000.0])
    lower, upper = np.full(4, 1.0), np.array([np.e**2, np.e**2, np.e**2, 1.0])  # no width at the last
    error = np.array([[0.1, 0.1, 0.3, 9.0], [0.1, 0.1, 0.3, 9.0]])
    typical, largest = relative_error(omega, (lower, upper), error)
    assert largest == pytest.approx(0.3)
    assert typical == pytest.approx(np.sqrt((0.01 + 2 * 0.5 * (0.01 + 0.09)) / 3))
    assert relative_error(omega[:1], (lower[:1], upper[:1]), error[:, :1]) == pytest.approx((0.1, 0.1))
    assert relative_error(omega[3:], (lower[3:], upper[3:]), error[:, 3:]) is None
    endless = np.full(4, np.inf)
    assert relative_error(omega, (endless, endless), error) is None


def test_frequencies_may_come_in_any_pieces() -> None:
    k, b = drawn(300, 2)
    whole = DrawCurves(DEVICE, k, b, PERIOD, level=0.9)
    bands = whole.at(OMEGA)
    parts = [whole.at(OMEGA[part]) for part in (slice(20, None), slice(0, 20))]
    np.testing.assert_array_equal(np.concatenate([parts[1].lower, parts[0].lower]), bands.lower)


def test_memory_stays_under_the_stated_bound() -> None:
    k, b = drawn(100_000, 3)
    curves = DrawCurves(DEVICE, k, b, PERIOD, level=0.99)
    omega = np.geomspace(0.1, 100.0, 40)
    tracemalloc.start()
    curves.at(omega)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MEMORY
    assert 8 * k.size * 2000 * 50 > 1000 * MEMORY  # all curves of a large study at once


def test_a_frequency_the_device_alone_decides() -> None:
    k, b = drawn(50, 6)
    curves = DrawCurves(DEVICE, k, b, PERIOD, level=0.9)
    at_nyquist = curves.at(np.array([np.pi / PERIOD]))
    assert np.isinf([at_nyquist.lower, at_nyquist.upper]).all()
    massless = DrawCurves(Device(0.0, 5.0), k, b, PERIOD, level=0.9)
    assert massless.at(np.array([np.pi / PERIOD])).sd[0] < 1e-12


def test_refused() -> None:
    k, b = drawn(5, 7)
    with pytest.raises(UsageError, match="two arrays of one length"):
        DrawCurves(DEVICE, k, b[:3], PERIOD, level=0.9)
    with pytest.raises(UsageError, match="at least 2"):
        DrawCurves(DEVICE, k[:1], b[:1], PERIOD, level=0.9)
    with pytest.raises(UsageError, match="level must lie in"):
        DrawCurves(DEVICE, k, b, PERIOD, level=1.0)
