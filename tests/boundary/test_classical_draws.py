from __future__ import annotations

import numpy as np
import pytest

from percept.boundary.classical_draws import confidence_draws
from percept.boundary.draw_ellipse import ellipse_of_draws
from percept.errors import RefusalError, UsageError
from percept.inference import prediction_interval, t_interval

RNG = np.random.default_rng(11)
Z = RNG.standard_normal((2, 10))
K, B = np.exp(9.0 + 0.1 * Z[0]), np.exp(2.0 + 0.3 * (0.6 * Z[0] + 0.8 * Z[1]))


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


def test_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(UsageError, match="no curve"):
        confidence_draws(K, B, kind="share", family="normal", draws=10, rng=rng)
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
