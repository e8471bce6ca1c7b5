"""The proposal's law: density, draws and turns are those of one law."""

import numpy as np
import pytest
from scipy import integrate, special, stats

from percept.inference.sampling.proposal import Proposal

DF = 15.0


def skewed(dimension, seed=0):
    """A law fitted to skewed, correlated draws."""
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(4000, dimension)) @ (np.eye(dimension) + 0.5 * np.tri(dimension, k=-1)).T
    return Proposal.fit(np.sinh(0.6 * z + 0.4) + 2.0)


def test_unskewed_density_is_multivariate_t():
    rng = np.random.default_rng(1)
    centre, mix = rng.normal(size=4), rng.normal(size=(4, 4))
    covariance = mix @ mix.T
    law = Proposal.normal(centre, covariance)
    points = centre + 3 * rng.normal(size=(50, 4))
    wanted = stats.multivariate_t(centre, covariance * (DF - 2) / DF, df=DF).logpdf(points)
    np.testing.assert_allclose(law.log_density(points), wanted, rtol=1e-7)


def test_skewed_density_is_t_times_the_jacobian():
    law = skewed(3)
    assert np.all(np.abs(law.skew) > 0.1)
    points = law.draw(40, np.random.default_rng(2))

    def back(x):
        return np.sinh(np.arcsinh((x - law.location) / law.width) - law.skew)

    step = 1e-5 * law.width
    log_slope = np.log((back(points + step) - back(points - step)) / (2 * step)).sum(axis=1)
    scale = law.factor @ law.factor.T
    wanted = stats.multivariate_t(law.centre, scale, df=DF).logpdf(back(points)) + log_slope
    np.testing.assert_allclose(law.log_density(points), wanted, rtol=1e-8)


def test_density_integrates_to_one():
    law = skewed(1)

    def density(x):
        return np.exp(law.log_density(np.array([[x]])))[0]

    low, high = law.draw(2000, np.random.default_rng(0)).min(), law.draw(2000, np.random.default_rng(0)).max()
    mass = integrate.quad(density, -np.inf, low)[0] + integrate.quad(density, high, np.inf)[0]
    mass += integrate.quad(density, low, high, limit=200)[0]
    assert abs(mass - 1) < 1e-7
    plane = skewed(2)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    # Over asinh of each coordinate, where the tails are short.
    t, jacobian = 9 * nodes, np.cosh(9 * nodes) * 9 * weights
    x, y = np.meshgrid(*(plane.location[i] + plane.width[i] * np.sinh(t + plane.skew[i]) for i in range(2)))
    jacobians = [np.cosh(t + plane.skew[i]) * plane.width[i] * 9 * weights for i in range(2)]
    values = np.exp(plane.log_density(np.stack([x.ravel(), y.ravel()], axis=1))).reshape(x.shape)
    assert jacobian.size == 400
    assert abs(jacobians[1] @ values @ jacobians[0] - 1) < 1e-6


def distances(law, points):
    """Mahalanobis distances of z, F-distributed under the law, as uniforms."""
    z = np.sinh(np.arcsinh((points - law.location) / law.width) - law.skew) - law.centre
    squared = ((z @ law.inverse.T) ** 2).sum(axis=1)
    return stats.f(law.centre.size, DF).cdf(squared / law.centre.size)


def coordinates(law, points):
    """Each whitened coordinate of z, t-distributed under the law, as uniforms."""
    z = np.sinh(np.arcsinh((points - law.location) / law.width) - law.skew) - law.centre
    return stats.t(DF).cdf(z @ law.inverse.T)


def turn(law, points, rng):
    """Turn by random angles, as the elliptic move does."""
    return law.turn(
        points,
        rng.standard_normal(points.shape),
        rng.standard_gamma(law.turn_shape, size=len(points)),
        0.5 * np.pi * rng.random(len(points)),
    )


@pytest.mark.parametrize("draw", ["draw", "turn", "turned ten times"])
def test_draws_and_turns_follow_the_law(draw):
    law = skewed(4)
    points = law.draw(20_000, np.random.default_rng(5))
    rng = np.random.default_rng(6)
    for _ in range({"draw": 0, "turn": 1, "turned ten times": 10}[draw]):
        points = turn(law, points, rng)
    assert stats.kstest(distances(law, points), "uniform").pvalue > 1e-4
    for column in coordinates(law, points).T:
        assert stats.kstest(column, "uniform").pvalue > 1e-4


def test_turn_is_reversible():
    """The joint law of a point and where it turns to is symmetric; a drift would show in odd moments."""
    law = skewed(3)
    before = law.draw(40_000, np.random.default_rng(7))
    after = turn(law, before, np.random.default_rng(8))
    u, v = coordinates(law, before), coordinates(law, after)
    for f, g in [
        (distances(law, before), distances(law, after)),
        (u[:, 0], v[:, 0]),
        (u[:, 1], v[:, 2] * 0 + v[:, 1]),
    ]:
        odd = f**2 * g - g**2 * f
        assert abs(odd.mean()) < 4.5 * odd.std() / np.sqrt(len(odd))
    assert np.corrcoef(u[:, 0], v[:, 0])[0, 1] > 0.4  # it is a turn, not a fresh draw


def test_fit_matches_median_and_spread_of_a_skewed_sample():
    sample = stats.gumbel_r().rvs((20_000, 2), random_state=np.random.default_rng(3))
    law = Proposal.fit(sample)
    draws = law.draw(100_000, np.random.default_rng(4))
    shares = special.ndtr([-2.0, 0.0, 2.0])
    found, wanted = np.quantile(draws, shares, axis=0), stats.gumbel_r().ppf(shares)[:, None]
    # A t law is a little wider than the normal whose quantiles are matched.
    assert np.all(np.abs(found - wanted) < 0.15 * np.abs(wanted - wanted[1]).max())
    assert np.all(law.skew > 0.1)


def test_weights_stand_for_repeated_points():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(300, 3))
    times = rng.integers(1, 4, size=300)
    weighted = Proposal.fit(points, times / times.sum(), skewed=False)
    repeated = Proposal.fit(np.repeat(points, times, axis=0), skewed=False)
    np.testing.assert_allclose(weighted.centre, repeated.centre, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(weighted.factor, repeated.factor, rtol=1e-10, atol=1e-13)
