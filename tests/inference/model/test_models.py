"""Models that put others together, or each cell by itself; a resolution that bounds spreads."""

import numpy as np
import pytest
from scipy import integrate, stats

from percept.errors import RefusalError
from percept.inference.model.model import Resolution, plain_model
from percept.inference.model.product import Unpooled
from tests.inference.model.designs import made
from tests.inference.model.test_statistics import reduce


def test_identical_subjects_have_an_answer_with_a_resolution():
    study = made("plain")
    study.study.response[study.study.cell == 2] = 0.1
    model = plain_model(
        reduce(study), resolution=Resolution(np.full((2, 3), 1e-6), np.zeros((2, 3)))
    )
    points = np.random.default_rng(1).normal(size=(200, len(model.names)))
    assert np.isfinite(model(points)).all()
    # The spread of that environment cannot run off to zero: the resolution bounds the density.
    far = np.zeros((2, len(model.names)))
    far[1, model.names.index("sigma[k,C2]")] = -30.0
    assert model(far)[1] < model(far)[0]


CELLS = (("k", "VE1"), ("k", "VE2"), ("b", "VE1"))


def test_unpooled_integrates_to_student_t():
    """Mixing beta | sigma over the posterior of sigma gives t with n - 1 degrees of freedom."""
    counts = np.array([2, 10, 25])
    model = Unpooled(CELLS, counts)
    for c, n in enumerate(counts):

        def law(u, c=c):
            point = np.zeros((1, 3))
            point[0, c] = u
            return model(point)[0] - model(np.zeros((1, 3)))[0], model.moments(point)

        def density(u, law=law):
            return np.exp(law(u)[0])

        mass = integrate.quad(density, -12, 60, limit=200, epsabs=1e-13)[0]
        for t in (0.0, 0.7, 2.5):

            def below(u, t=t, c=c, n=n, density=density, law=law):
                laws = law(u)[1]
                return density(u) * stats.norm.cdf(
                    (t / np.sqrt(n) - laws.mean[0, c]) / laws.sd[0, c]
                )

            found = integrate.quad(below, -12, 60, limit=200, epsabs=1e-13)[0] / mass
            assert abs(found - stats.t.cdf(t, n - 1)) < 1e-8, (n, t)


def test_unpooled_laws_and_draws():
    model = Unpooled(CELLS, np.array([3, 5, 9]))
    points = np.repeat(np.array([[0.3, -1.0, 0.5]]), 40_000, axis=0)
    laws = model.moments(points[:1])
    sigma = np.exp(points[0] / np.sqrt(2 * np.array([2.0, 4.0, 8.0])))
    np.testing.assert_allclose(laws.population_sd[0], sigma, rtol=1e-14)
    np.testing.assert_allclose(laws.sd[0], sigma / np.sqrt([3, 5, 9]), rtol=1e-14)
    np.testing.assert_allclose(model.scales(points[:1])["sigma_ratio"][1][0], sigma, rtol=1e-14)
    means, users = model.draw(points, np.random.default_rng(8))
    error = 4.5 / np.sqrt(2 * 40_000)
    assert np.all(np.abs(means.std(axis=0) / laws.sd[0] - 1) < error)
    assert np.all(
        np.abs(users.std(axis=0) / np.hypot(laws.sd[0], laws.population_sd[0]) - 1) < error
    )
    assert np.all(np.abs((users - means).std(axis=0) / laws.population_sd[0] - 1) < error)
    assert model.names == ["log sigma[k,VE1]", "log sigma[k,VE2]", "log sigma[b,VE1]"]


def test_unpooled_refuses_a_single_subject():
    with pytest.raises(RefusalError, match=r"k in VE2 has one subject.*needs two\..*partial"):
        Unpooled(CELLS, np.array([3, 1, 4]))
