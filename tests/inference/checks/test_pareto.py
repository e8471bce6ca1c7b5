"""Smoothed importance weights against ArviZ's, to the last bit."""

import warnings

import arviz_base
import arviz_stats
import numpy as np
import pytest

from percept.inference.checks.left_out import smoothed_subjects
from percept.inference.checks.pareto import smoothed_log_weights


@pytest.mark.parametrize("draws", [40, 224, 226, 4000])
@pytest.mark.parametrize("freedom", [1.5, 3, 30])
def test_weights_equal_arviz(draws, freedom):
    rng = np.random.default_rng(draws)
    densities = -rng.standard_t(freedom, size=(2, draws // 2, 5))
    tree = arviz_base.from_dict(
        {"log_likelihood": {"trials": densities}}, dims={"trials": ["subject"]}
    )
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Estimated shape parameter")
        theirs = arviz_stats.loo(tree, pointwise=True, reff=1.0)
    flat = densities.reshape(draws, 5)
    ours = smoothed_subjects(flat, flat)
    np.testing.assert_array_equal(ours.pointwise, theirs.elpd_i)
    np.testing.assert_array_equal(ours.pareto_k, theirs.pareto_k)
    assert ours.good_k == theirs.good_k
    log_weights = theirs.log_weights.transpose("chain", "draw", "subject").to_numpy()
    ratios = np.exp(log_weights.reshape(flat.shape) - log_weights.max())
    np.testing.assert_allclose(ours.weights, ratios / ratios.sum(axis=0), rtol=1e-13, atol=0)


def test_only_the_tail_changes_and_the_largest_weight_grows_no_more():
    ratios = np.random.default_rng(1).standard_t(2, size=1000)
    log_weights, index = smoothed_log_weights(ratios)
    order = np.argsort(ratios)
    body = order[: -int(3 * 1000**0.5)]
    np.testing.assert_allclose(np.diff(log_weights[body]), np.diff(ratios[body]), atol=1e-12)
    assert log_weights.max() - log_weights[body[0]] <= np.ptp(ratios) + 1e-12
    assert index > 0.7
    assert np.exp(log_weights).sum() == pytest.approx(1.0)
