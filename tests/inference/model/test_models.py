"""Models that put others together, or each cell by itself; a resolution that bounds spreads."""

import numpy as np
import pytest

from percept.errors import RefusalError
from percept.inference.model.model import LinearModel, Unpooled
from percept.inference.model.statistics import Resolution
from tests.inference.model.designs import made
from tests.inference.model.test_statistics import reduce


def test_identical_subjects_have_an_answer_with_a_resolution():
    study = made("plain")
    study.study.response[study.study.cell == 2] = 0.1
    resolution = Resolution(np.full((2, 3), 1e-6), np.zeros((2, 3)))
    model = LinearModel(reduce(study), study.model.design, resolution=resolution)
    points = np.random.default_rng(1).normal(size=(200, len(model.names)))
    assert np.isfinite(model(points)).all()
    # The spread of that environment cannot run off to zero: the resolution bounds the density.
    far = np.zeros((2, len(model.names)))
    far[1, model.names.index("sigma[k,C2]")] = -30.0
    assert model(far)[1] < model(far)[0]


CELLS = (("k", "VE1"), ("k", "VE2"), ("b", "VE1"))


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
