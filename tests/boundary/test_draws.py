from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from percept.boundary.draws import MEMORY, DrawCurves, pointwise_band
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
