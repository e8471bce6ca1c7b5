"""Densities of subjects left out, against the twin's covariances over every trial."""

import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError
from percept.inference.left_out import SubjectDensity
from percept.inference.model.design import Options
from percept.inference.model.model import plain_model
from percept.inference.model.statistics import from_trials
from percept.inference.predictive import leave_one_out
from tests.inference.model.designs import made

DESIGNS = [
    "plain",
    "one quantity",
    "plain, trials",
    "plain, unequal trials",
    "plain, missing cells",
    "two subjects",
    "one cell, unequal trials",
    "no subject effect, missing cells",
    "common spread of a constant share",
    "resolution",
    "two levels, trials",
    "two by two, spread",
    "three levels, missing cells",
    "two groups",
    "subjects' trial SDs",
    "one environment",
]


def opened(name):
    study = made(name)
    trials = study.study
    return study, SubjectDensity(study.model, trials.response, trials.subject, trials.cell)


def averages(study, subject):
    """Rows that average a subject's trials in each cell, quantity by quantity; and the cells."""
    own = study.cell[study.subject == subject]
    cells = np.unique(own)
    rows = np.stack([(own == cell) / np.sum(own == cell) for cell in cells])
    return np.kron(np.eye(study.response.shape[1]), rows), cells


@pytest.mark.parametrize("name", DESIGNS)
def test_a_subject_left_out_is_predicted_by_the_others_trials(name):
    """Density, distance and standard scores by conditioning the covariance of all trials."""
    study, subjects = opened(name)
    point = study.points(1, spread=0.5)
    covariance = study.twin(point).observed[0]
    trials = study.study
    response = trials.response.T.ravel()
    size = trials.response.shape[1]
    found = subjects.left_out(point)
    for i in range(subjects.subjects):
        own = np.tile(trials.subject == i, size)
        gain = np.linalg.solve(covariance[np.ix_(~own, ~own)], covariance[np.ix_(~own, own)]).T
        mean = gain @ response[~own]
        left = covariance[np.ix_(own, own)] - gain @ covariance[np.ix_(~own, own)]
        expected = stats.multivariate_normal(mean, left).logpdf(response[own])
        assert found.log_density[0, i] == pytest.approx(expected, rel=1e-7, abs=1e-7)
        rows, cells = averages(trials, i)
        apart = rows @ (response[own] - mean)
        within = rows @ left @ rows.T
        distance = apart @ np.linalg.solve(within, apart)
        assert found.distance[0, i] == pytest.approx(distance, rel=1e-7)
        standard = found.standard[0, i]
        known = standard[:, cells].ravel()
        np.testing.assert_allclose(known, apart / np.sqrt(np.diag(within)), rtol=1e-6, atol=1e-8)
        assert np.isnan(np.delete(standard, cells, axis=1)).all()


def without_the_first(study):
    """The model of all subjects but the first."""
    trials, statistics = study.study, study.model.statistics
    rest = trials.subject > 0
    others = from_trials(
        trials.response[rest],
        trials.subject[rest] - 1,
        trials.cell[rest],
        trials.x,
        parameters=statistics.parameters,
        environments=statistics.environments,
        subjects=statistics.subjects[1:],
    )
    return plain_model(others)


def test_scales_of_any_size_keep_the_digits_of_the_densities():
    """Spreads over seven orders of magnitude: the density of all less that of the others."""
    study, subjects = opened("plain")
    model = study.model
    points = study.points(200, spread=2.5)
    points[:, [name.startswith("sigma[") for name in model.names]] *= 4.0
    scales = model.coordinates(points)
    sd = scales.named["sigma"]
    assert sd.max() / sd.min() > 1e7
    every = model.log_likelihood(scales.cells)
    others = without_the_first(study).log_likelihood(scales.cells)
    found = subjects.left_out(points).log_density[:, 0]
    # The difference itself rounds at the size of its terms.
    np.testing.assert_array_less(np.abs(found - (every - others)), 1e-9 * (1.0 + np.abs(every)))


def test_one_subject_alone_with_next_to_no_scatter_is_refused():
    response = np.random.default_rng(26).normal(size=(3, 1))
    subject, cell = np.arange(3), np.array([0, 1, 1])
    statistics = from_trials(
        response,
        subject,
        cell,
        np.array([[-0.5, 0.5]]),
        parameters=("k",),
        environments=("VE1", "VE2"),
        subjects=("S01", "S02", "S03"),
    )
    model = plain_model(statistics, options=Options(subject_effect=False))
    subjects = SubjectDensity(model, response, subject, cell)
    points = np.zeros((4, len(model.names)))
    points[:, [name.startswith("sigma[") for name in model.names]] = -20.0
    found = subjects.left_out(points)
    assert np.isnan(found.log_density[:, 0]).all()
    assert np.isnan(found.standard[:, 0]).all()
    with pytest.raises(RefusalError, match="S01 cannot be predicted from the others"):
        leave_one_out(subjects, found)
