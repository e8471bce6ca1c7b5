"""The log density of every design against the twin, which writes all covariances out."""

import numpy as np
import pytest

from percept.inference.model.priors import Priors
from tests.inference.model.designs import DESIGNS, made


@pytest.mark.parametrize("name", DESIGNS)
def test_log_density_is_that_of_the_trials_and_of_the_prior(name):
    """The prior by its natural law, times the Jacobian of the coordinates by differences."""
    study = made(name)
    model = study.model
    points = study.points(2)
    step = 1e-6
    for point, value in zip(points, model(points), strict=True):
        ends = point + step * np.vstack([np.eye(len(point)), -np.eye(len(point))])
        up, down = np.split(study.twin(ends).variables(), 2)
        sign, log_jacobian = np.linalg.slogdet((up - down) / (2.0 * step))
        assert sign != 0.0
        here = study.twin(point[None])
        expected = here.log_likelihood() + here.log_prior() + log_jacobian
        assert value == pytest.approx(expected[0], abs=1e-7)


@pytest.mark.parametrize("name", DESIGNS)
def test_log_likelihood_is_that_of_the_trials(name):
    study = made(name)
    points = study.points(20)
    found = study.model.log_likelihood(study.model.coordinates(points).cells)
    expected = study.twin(points).log_likelihood()
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-10)


@pytest.mark.parametrize(
    "name", ["plain", "plain, missing cells", "two by two, spread", "subjects' trial SDs"]
)
def test_a_value_does_not_depend_on_its_batch(name):
    study = made(name)
    points = study.points(1100, spread=1.0)
    whole = study.model(points)
    for size in (2, 256, 1024):
        np.testing.assert_allclose(study.model(points[:size]), whole[:size], rtol=1e-12)
    # numpy sums a single column in another order.
    np.testing.assert_allclose(study.model(points[:1]), whole[:1], rtol=1e-13)


@pytest.mark.parametrize("name", ["plain, trials", "plain, missing cells", "two by two, spread"])
@pytest.mark.parametrize("spread", [5.0, 12.0])
def test_extreme_scales_have_a_density_and_laws_or_none(name, spread):
    study = made(name)
    points = study.points(200, spread)
    values = study.model(points)
    assert not np.isnan(values).any()
    weighed = points[np.isfinite(values)]
    assert len(weighed) > 20
    laws = study.model.moments(weighed)
    assert np.isfinite(laws.mean).all()
    assert (laws.sd > 0.0).all()


def test_wrong_priors_change_the_density():
    """The prior SD of a contrast is felt, so that the comparisons above can fail."""
    wide = made("two levels, trials")
    narrow = made("two levels, trials", priors=Priors(lambda_sd=0.01))
    points = wide.points()
    assert (np.abs(wide.model(points) - narrow.model(points)) > 1e-3).all()
