"""The reference law: density, draws and turns are those of one law."""

import numpy as np
import pytest
from scipy import stats

from percept.inference.sampling.moves import ReferenceLaw

DF = 20.0


def test_density_is_multivariate_t():
    points = 3 * np.random.default_rng(1).normal(size=(50, 4))
    wanted = stats.multivariate_t(np.zeros(4), np.eye(4), df=DF).logpdf(points)
    np.testing.assert_allclose(ReferenceLaw(4).log_density(points), wanted, rtol=1e-13)


def distances(points):
    """Squared distances over the dimension, F-distributed under the law, as uniforms."""
    size = points.shape[1]
    return stats.f(size, DF).cdf((points**2).sum(axis=1) / size)


@pytest.mark.parametrize("turns", [0, 1, 10])
def test_draws_and_turns_follow_the_law(turns):
    law = ReferenceLaw(4)
    points = law.draw(20_000, np.random.default_rng(5))
    rng = np.random.default_rng(6)
    for _ in range(turns):
        points = law.rotate(points, rng)
    assert stats.kstest(distances(points), "uniform").pvalue > 1e-4
    for column in stats.t(DF).cdf(points).T:
        assert stats.kstest(column, "uniform").pvalue > 1e-4


def test_turn_is_reversible():
    """The joint law of a point and where it turns to is symmetric; a drift would show in odd
    moments."""
    law = ReferenceLaw(3)
    before = law.draw(40_000, np.random.default_rng(7))
    after = law.rotate(before, np.random.default_rng(8))
    u, v = stats.t(DF).cdf(before), stats.t(DF).cdf(after)
    pairs = [(distances(before), distances(after)), (u[:, 0], v[:, 0]), (u[:, 1], v[:, 1])]
    for f, g in pairs:
        odd = f**2 * g - g**2 * f
        assert abs(odd.mean()) < 4.5 * odd.std() / np.sqrt(len(odd))
    assert np.corrcoef(u[:, 0], v[:, 0])[0, 1] > 0.4  # it is a turn, not a fresh draw
