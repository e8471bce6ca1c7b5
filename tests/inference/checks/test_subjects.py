"""Densities of subjects against dense multivariate normals over every trial."""

import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError
from percept.inference.checks.left_out import leave_one_out
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.model import Resolution
from percept.inference.hierarchy.scales import Options
from tests.inference.hierarchy import dense_twin, designs


def left_out(subjects, scales):
    """Predict subjects at given scales."""
    return subjects.left_out(subjects.density.subject_laws_at(scales))


def prepared(name, rng, options=None, draws=2):
    study = designs.study(name, rng)
    density = CollapsedDensity(study.statistics, options=options)
    coords = 0.7 * rng.normal(size=(density.dimension, draws))
    subjects = SubjectDensity(density, study.response, study.subject, study.environment)
    return study, density, density.layout.scales(coords), subjects


def of_trials(study, scales, w, **prior):
    return dense_twin.trial_covariance(
        study.subject, study.environment, study.x, scales, w, **prior
    )


def flat(study, who):
    size = study.response.shape[1]
    return np.concatenate([np.arange(size) + size * m for m in np.flatnonzero(who)])


CASES = [(name, Options()) for name in designs.NAMES]
for options in (Options(subject_effect=False), Options(weber=True, common_spread=True)):
    CASES += [(name, options) for name in ("balanced", "missing cells", "one environment each")]


@pytest.mark.parametrize(("name", "options"), CASES)
def test_left_out_equals_conditioning_on_the_other_trials(name, options):
    rng = np.random.default_rng(22)
    study, _, scales, subjects = prepared(name, rng, options)
    found = left_out(subjects, scales)
    w = 0
    covariance = of_trials(study, scales, w, alpha_sd=1.0, gamma_sd=0.25)
    response = study.response.ravel()
    for i in range(subjects.subjects):
        inside, outside = flat(study, study.subject == i), flat(study, study.subject != i)
        gain = np.linalg.solve(
            covariance[np.ix_(outside, outside)], covariance[np.ix_(outside, inside)]
        ).T
        law = stats.multivariate_normal(
            gain @ response[outside],
            covariance[np.ix_(inside, inside)] - gain @ covariance[np.ix_(outside, inside)],
        )
        assert found.log_density[w, i] == pytest.approx(
            law.logpdf(response[inside]), rel=1e-7, abs=1e-7
        )
        check_means(study, i, law, found, w)


def check_means(study, i, law, found, w):
    """The predictive law of cell means from that of the trials."""
    who = study.subject == i
    environments = np.unique(study.environment[who])
    size = study.response.shape[1]
    average = np.stack(
        [
            np.kron(
                (study.environment[who] == j) / np.sum(study.environment[who] == j), np.eye(size)[p]
            )
            for p in range(size)
            for j in environments
        ]
    )
    mean, covariance = average @ law.mean, average @ law.cov @ average.T
    off = average @ study.response[who].ravel() - mean
    standard = found.standard[w, i][:, environments].ravel()
    np.testing.assert_allclose(standard, off / np.sqrt(np.diag(covariance)), rtol=1e-6, atol=1e-8)
    assert found.distance[w, i] == pytest.approx(off @ np.linalg.solve(covariance, off), rel=1e-6)
    missing = np.setdiff1d(np.arange(study.x.shape[1]), environments)
    assert np.isnan(found.standard[w, i][:, missing]).all()


def test_resolution_widens_both_levels():
    rng = np.random.default_rng(25)
    study, density, scales, subjects = prepared("trials", rng)
    added = np.full(study.x.shape, 0.3)
    wide = SubjectDensity(
        CollapsedDensity(study.statistics, resolution=Resolution(between=added, trial=added)),
        study.response,
        study.subject,
        study.environment,
    )
    ours = left_out(wide, scales).log_density
    others = without_the_first(study)
    reduced = CollapsedDensity(others, resolution=Resolution(between=added, trial=added))
    difference = wide.density.log_likelihood(scales) - reduced.log_likelihood(scales)
    np.testing.assert_allclose(ours[:, 0], difference, rtol=1e-9)
    assert not np.allclose(ours, left_out(subjects, scales).log_density)
    assert density.resolution.between is None


def test_one_subject_alone_with_next_to_no_scatter_is_refused():
    rng = np.random.default_rng(26)
    trials = {(0, 0): 1, (1, 1): 1, (2, 1): 1}
    study = designs._simulate(("k",), 2, 3, trials, rng)
    density = CollapsedDensity(study.statistics, options=Options(subject_effect=False))
    subjects = SubjectDensity(density, study.response, study.subject, study.environment)
    points = np.zeros((4, density.dimension))
    points[:, [name.startswith("sigma[") for name in density.names]] = -20.0
    found = subjects.left_out(density.subject_laws(points))
    assert np.isnan(found.log_density[:, 0]).all()
    assert np.isnan(found.standard[:, 0]).all()
    with pytest.raises(RefusalError, match="S01 cannot be predicted from the others"):
        leave_one_out(subjects, points, chains=4)


def test_scales_of_any_size_keep_the_digits_of_the_collapsed_densities():
    """Spreads over seven orders of magnitude: still the density of all less that of the others."""
    rng = np.random.default_rng(28)
    study, density, _, subjects = prepared("balanced", rng)
    coords = 2.5 * rng.normal(size=(density.dimension, 200))
    coords[[name.startswith("sigma[") for name in density.names]] *= 4.0
    scales = density.layout.scales(coords)
    others = without_the_first(study)
    all_of_them, less = (
        density.log_likelihood(scales),
        CollapsedDensity(others).log_likelihood(scales),
    )
    found = left_out(subjects, scales).log_density[:, 0]
    sd = scales.named["sigma"]
    assert sd.max() / sd.min() > 1e7
    # The difference itself rounds at the size of its terms.
    np.testing.assert_array_less(
        np.abs(found - (all_of_them - less)), 1e-9 * (1.0 + np.abs(all_of_them))
    )


def without_the_first(study):
    rest = study.subject > 0
    return designs.from_trials(
        study.response[rest],
        study.subject[rest] - 1,
        study.environment[rest],
        study.x,
        parameters=study.statistics.parameters,
        environments=study.statistics.environments,
        subjects=study.statistics.subjects[1:],
    )
