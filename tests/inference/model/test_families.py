"""The level at which limits hold together, against closed forms and a published table."""

import numpy as np
import pytest
from scipy import special

from percept.inference.model.limits import level_together

DRAWS = 200_000
LEVEL = 0.95


def score(correlation, count, *, seed=1):
    """Score of normals with one correlation, known as one normal law each."""
    rng = np.random.default_rng(seed)
    common = rng.standard_normal((DRAWS, 1))
    own = rng.standard_normal((DRAWS, count))
    values = np.sqrt(correlation) * common + np.sqrt(1.0 - correlation) * own
    level = level_together(np.zeros((1, count)), np.ones((1, count)), values, LEVEL)
    return special.ndtri(0.5 * (1.0 + level))


# Of a share of .05 by 200,000 draws, over the slope of the tail: three standard errors.
ERROR = 3.0 * np.sqrt(0.05 * 0.95 / DRAWS) / 0.115


@pytest.mark.parametrize("count", [2, 3, 8])
def test_independent_quantities_have_the_level_of_sidak(count):
    expected = special.ndtri(0.5 * (1.0 + LEVEL ** (1.0 / count)))
    assert score(0.0, count) == pytest.approx(expected, abs=ERROR + 0.003)


# C. W. Dunnett, Biometrics 20, 482-491 (1964), table II: two-sided, P = .95, infinite df.
@pytest.mark.parametrize(("count", "published"), [(2, 2.21), (3, 2.35), (4, 2.44), (5, 2.51)])
def test_equally_correlated_quantities_have_dunnett_s_level(count, published):
    assert score(0.5, count) == pytest.approx(published, abs=ERROR + 0.003 + 0.005)


def test_quantities_that_move_as_one_keep_their_level():
    assert score(1.0 - 1e-12, 6) == pytest.approx(special.ndtri(0.975), abs=ERROR + 0.003)


def test_mixtures_hold_their_share_of_draws():
    """Of scales that vary, with one quantity ten times the other's size."""
    rng = np.random.default_rng(2)
    sd = np.exp(rng.normal(0.0, 0.5, (400, 1))) * np.array([1.0, 10.0])
    mean = rng.normal(0.0, 1.0, (400, 2))
    values = np.concatenate([mean + sd * rng.standard_normal((400, 2)) for _ in range(400)])
    level = level_together(mean, sd, values, LEVEL)
    tail = 0.5 * (1.0 - level)
    inside = (values > np.quantile(values, tail, axis=0)) & (
        values < np.quantile(values, 1.0 - tail, axis=0)
    )
    assert inside.all(axis=1).mean() == pytest.approx(LEVEL, abs=0.004)
    assert LEVEL < level < 1.0 - 0.5 * (1.0 - LEVEL)
