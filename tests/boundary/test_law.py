"""Laws of (k, b) on their grids, against closed forms and draws."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import special

from percept.boundary.law import PairLaw, confidence_law, mixture_law
from percept.errors import RefusalError
from percept.inference import prediction_interval, t_interval

RNG = np.random.default_rng(11)
Z = RNG.standard_normal((2, 10))
K, B = np.exp(9.0 + 0.1 * Z[0]), np.exp(2.0 + 0.3 * (0.6 * Z[0] + 0.8 * Z[1]))


def margin(law: PairLaw, p: int, values: np.ndarray) -> np.ndarray:
    """Probability of k or b up to values: all of the other one summed over."""
    axis, table = law.axes[p], law.cumulated[p]
    # Trapezia over the outer coordinate: exact for a density that ends at nothing.
    held = table.sum(axis=0) / table[:, -1].sum()
    return np.interp(values, axis.native(np.linspace(0.0, 1.0, table.shape[1])), held)


def mixture(count: int = 400, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Means, and covariances of SDs that scatter by a factor of two, with correlations of all
    sizes."""
    rng = np.random.default_rng(seed)
    mean = np.array([9.0, 2.0]) + np.array([0.05, 0.2]) * rng.standard_normal((count, 2))
    sd = np.array([0.08, 0.3]) * np.exp(0.35 * rng.standard_normal((count, 2)))
    rho = rng.uniform(-0.8, 0.95, count)
    covariance = sd[:, :, None] * sd[:, None, :]
    covariance[:, 0, 1] *= rho
    covariance[:, 1, 0] *= rho
    return mean, covariance


@pytest.mark.parametrize("batch", [0, 3])
def test_margins_of_a_mixture_are_means_of_normals(batch: int) -> None:
    mean, covariance = mixture()
    label = np.arange(400) % 4
    law = mixture_law(mean, covariance, label, "lognormal")
    np.testing.assert_allclose(law.shares, 0.25)
    some = label == batch - 1 if batch else slice(None)
    of = dataclasses.replace(law, density=law.batches[batch - 1]) if batch else law
    for p in range(2):
        axis = law.axes[p]
        values = axis.native(np.linspace(0.0, 1.0, 4 * (axis.size - 1) + 1))[::7]
        sd = np.sqrt(covariance[some, p, p])
        exact = special.ndtr((np.log(values)[:, None] - mean[some, p]) / sd).mean(axis=1)
        np.testing.assert_allclose(margin(of, p, values), exact, atol=3e-5)


@pytest.mark.parametrize("family", ["normal", "lognormal"])
@pytest.mark.parametrize(
    ("kind", "interval"), [("mean", t_interval), ("user", prediction_interval)]
)
def test_margins_are_the_classical_intervals(family: str, kind: str, interval: object) -> None:
    law = confidence_law(K, B, kind=kind, family=family)  # type: ignore[arg-type]
    for p, values in enumerate((K, B)):
        exact = interval(values, level=0.99, family=family)  # type: ignore[operator]
        ends = np.array([exact.lower, exact.upper])
        np.testing.assert_allclose(margin(law, p, ends), [0.005, 0.995], atol=3e-5)


def test_samples_without_a_distribution_are_refused() -> None:
    with pytest.raises(RefusalError, match="At least 3 subjects"):
        confidence_law(K[:2], B[:2], kind="mean", family="normal")
    with pytest.raises(RefusalError, match="no scatter"):
        confidence_law(K, np.ones(10), kind="mean", family="normal")


def test_ellipse_of_a_law_holds_its_level_and_follows_its_family() -> None:
    covariance = np.array([[0.01, 0.6 * 0.03], [0.6 * 0.03, 0.09]])
    law = mixture_law(
        np.array([[9.0, 2.0]] * 8), np.array([covariance] * 8), np.arange(8), "lognormal"
    )
    ellipse = law.ellipse(kind="user", level=0.9, n=10)
    # Of one normal the radius is that of a chi square with two degrees of freedom.
    assert ellipse.radius == pytest.approx(np.sqrt(-2 * np.log(0.1)), rel=0.005)
    assert ellipse.shape[0, 1] / np.prod(ellipse.sd) == pytest.approx(0.6)
    k, b = np.exp(np.random.default_rng(3).multivariate_normal([9.0, 2.0], covariance, 40_000).T)
    inside = ellipse.distance(k, b) <= ellipse.radius
    assert inside.mean() == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / 40_000) + 0.002)
