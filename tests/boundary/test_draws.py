from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from percept.boundary.draws import (
    MEMORY,
    DrawCurves,
    confidence_draws,
    ellipse_of_draws,
    relative_error,
)
from percept.errors import RefusalError, UsageError
from percept.haptics import Device, Environment, perceived_impedance
from percept.inference import prediction_interval, t_interval

DEVICE, PERIOD = Device(1.0, 5.0), 1e-3
OMEGA = np.geomspace(0.1, 100.0, 37)
RNG = np.random.default_rng(11)
Z = RNG.standard_normal((2, 10))
K, B = np.exp(9.0 + 0.1 * Z[0]), np.exp(2.0 + 0.3 * (0.6 * Z[0] + 0.8 * Z[1]))


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
    bands = DrawCurves(DEVICE, k, b, PERIOD, level=level).at(OMEGA)
    np.testing.assert_allclose([bands.lower, bands.upper], np.quantile(curves, tails, axis=0), rtol=1e-13)


def test_sd_of_few_draws_is_that_of_a_sample() -> None:
    k, b = drawn(5, 8)
    logs = np.log(slow_curves(k, b))
    curves = DrawCurves(DEVICE, k, b, PERIOD, level=0.9)
    # Logarithms of a few hundred are good to 1e-15, deviations of some hundredths to 1e-13.
    np.testing.assert_allclose(curves.at(OMEGA).sd, logs.std(axis=0, ddof=1), rtol=1e-11)


def test_error_is_half_the_distance_of_two_halves() -> None:
    k, b = drawn(400, 9)
    parts = (
        DrawCurves(DEVICE, k[p], b[p], PERIOD, level=0.9).at(OMEGA) for p in (slice(200), slice(200, None))
    )
    halves = [np.log([part.lower, part.upper]) for part in parts]
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


@pytest.mark.parametrize("family", ["normal", "lognormal"])
@pytest.mark.parametrize(("kind", "interval"), [("mean", t_interval), ("user", prediction_interval)])
def test_margins_are_the_classical_intervals(family: str, kind: str, interval: object) -> None:
    """The tail of 64 runs gives the tolerance: their scatter, over the root of their number."""
    found = []
    for seed in range(64):
        draws = confidence_draws(K, B, kind=kind, family=family, draws=4096, rng=np.random.default_rng(seed))
        found.append([np.quantile(part, [0.005, 0.995]) for part in draws])
    ends = np.log(found) if family == "lognormal" else np.array(found)
    error = ends.std(axis=0, ddof=1) / 8.0
    for p, values in enumerate((K, B)):
        exact = interval(values, level=0.99, family=family)  # type: ignore[operator]
        limits = np.array([exact.lower, exact.upper])
        limits = np.log(limits) if family == "lognormal" else limits
        # A quantile of 4096 draws has a bias of its own, of order one draw: 1/4096 of the density there.
        bias = 0.01 * (limits[1] - limits[0])
        assert np.all(np.abs(ends[:, p].mean(axis=0) - limits) < 4 * error[p] + bias)


def test_k_and_b_go_together_as_in_the_sample() -> None:
    k, b = confidence_draws(
        K, B, kind="mean", family="lognormal", draws=100_000, rng=np.random.default_rng(1)
    )
    sample = np.corrcoef(np.log(K), np.log(B))[0, 1]
    assert np.corrcoef(np.log(k), np.log(b))[0, 1] == pytest.approx(sample, abs=0.02)


def test_radius_has_the_law_of_a_bivariate_t() -> None:
    k, b = confidence_draws(K, B, kind="mean", family="normal", draws=8192, rng=np.random.default_rng(2))
    points = np.stack([k - K.mean(), b - B.mean()])
    squared = np.einsum("in,ij,jn->n", points, np.linalg.inv(np.cov(K, B) / 10), points)
    for p in (0.5, 0.9, 0.99):
        exact = 9 * ((1 - p) ** (-2 / 9) - 1)  # twice the F quantile with 2 and 9 degrees of freedom
        assert np.quantile(squared, p) == pytest.approx(exact, rel=5e-3)


def test_samples_without_a_distribution_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(UsageError, match="one stiffness and one damping per subject"):
        confidence_draws(K, B[:5], kind="mean", family="normal", draws=10, rng=rng)
    with pytest.raises(RefusalError, match="At least 3 subjects"):
        confidence_draws(K[:2], B[:2], kind="mean", family="normal", draws=10, rng=rng)
    with pytest.raises(RefusalError, match="no scatter"):
        confidence_draws(K, np.ones(10), kind="mean", family="normal", draws=10, rng=rng)


def test_ellipse_of_draws_holds_its_level_and_follows_its_family() -> None:
    rng = np.random.default_rng(3)
    z = rng.standard_normal((2, 40_000))
    k, b = np.exp(9.0 + 0.1 * z[0]), np.exp(2.0 + 0.3 * (0.6 * z[0] + 0.8 * z[1]))
    ellipse = ellipse_of_draws(k, b, kind="user", family="lognormal", level=0.9, n=10)
    assert ellipse.contains(k, b).mean() == pytest.approx(0.9, abs=1e-4)
    # Of normal draws the radius is that of a chi square with two degrees of freedom.
    assert ellipse.radius == pytest.approx(np.sqrt(-2 * np.log(0.1)), rel=0.01)
    assert ellipse.correlation == pytest.approx(0.6, abs=0.02)
    with pytest.raises(RefusalError, match="lie on a line"):
        ellipse_of_draws(k, k, kind="user", family="normal", level=0.9, n=10)
