"""Priors and statistics against exact laws and simulated studies."""

import numpy as np
import pytest
from scipy import stats

from percept.inference.checks.predictive import (
    new_studies,
    statistics_of,
)
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.density import CollapsedDensity
from tests.inference.checks.test_subjects import prepared
from tests.inference.hierarchy import designs
from tests.inference.hierarchy.test_prior import OTHER


def laws(priors):
    rho = stats.beta(priors.rho_shape, priors.rho_shape, loc=-1.0, scale=2.0)
    half = {
        name: stats.halfnorm(scale=getattr(priors, f"{name}_scale")) for name in ("tau", "sigma_u")
    }
    half |= {
        name: stats.halfnorm(scale=getattr(priors, f"{name}_scale"))
        for name in ("omega", "omega_e")
    }
    log_s = {
        "s" + e: stats.lognorm(
            getattr(priors, f"log_s{e}_sd"), scale=np.exp(getattr(priors, f"log_s{e}_mean"))
        )
        for e in ("", "_e")
    }
    kappa = {"kappa" + e: stats.norm(0.0, getattr(priors, f"kappa{e}_sd")) for e in ("", "_e")}
    return half | log_s | kappa | dict.fromkeys(("rho_w", "rho_u", "rho_e"), rho)


@pytest.mark.parametrize("name", ["trials", "one environment", "k only"])
def test_draws_have_their_priors(name):
    rng = np.random.default_rng(31)
    study = designs.study(name, rng)
    density = CollapsedDensity(study.statistics, OTHER)
    draws = 20_000
    prior = density.draw_prior(draws, rng)
    named, means, users = prior.scales, prior.means, prior.users
    known = laws(OTHER)
    for key, (dimensions, value) in named.items():
        assert len(dimensions) == value.ndim - 1
        if key in known:
            assert stats.kstest(value.reshape(draws, -1)[:, 0], known[key].cdf).pvalue > 1e-4, key
    if name == "one environment":
        level = stats.lognorm(OTHER.log_s_sd, scale=np.exp(OTHER.log_s_mean))
        assert stats.kstest(named["sigma"][1][:, 0, 0], level.cdf).pvalue > 1e-4
        assert stats.kstest(means[:, 0], stats.norm(0.0, OTHER.alpha_sd).cdf).pvalue > 1e-4
    else:
        sd = np.sqrt(
            OTHER.alpha_sd**2 + OTHER.gamma_sd**2 * study.x[0, 0] ** 2 + named["tau"][1][:, 0] ** 2
        )
        # Given tau the location is normal; the data, which have other scales, do not enter.
        assert stats.kstest(means[:, 0] / sd, stats.norm.cdf).pvalue > 1e-4
        log_sigma = np.log(named["sigma"][1][:, 0, 0])
        centre = np.log(named["s"][1][:, 0]) + named["kappa"][1][:, 0] * study.x[0, 0]
        assert (
            stats.kstest((log_sigma - centre) / named["omega"][1][:, 0], stats.norm.cdf).pvalue
            > 1e-4
        )
    spread = named["sigma"][1][:, 0, 0] ** 2 + (
        named["sigma_u"][1][:, 0] ** 2 if "sigma_u" in named else 0.0
    )
    assert stats.kstest((users - means)[:, 0] / np.sqrt(spread), stats.norm.cdf).pvalue > 1e-4


def test_users_of_one_draw_are_correlated_as_the_draw_says():
    rng = np.random.default_rng(32)
    density = CollapsedDensity(designs.study("one environment", rng).statistics)
    prior = density.draw_prior(20_000, rng)
    named, means, users = prior.scales, prior.means, prior.users
    off = (users - means) / named["sigma"][1][:, :, 0]
    rho = named["rho_w"][1]
    left = (off[:, 1] - rho * off[:, 0]) / np.sqrt(1.0 - rho**2)
    assert stats.kstest(left, stats.norm.cdf).pvalue > 1e-4
    assert abs(np.corrcoef(left, off[:, 0])[0, 1]) < 5 / np.sqrt(20_000)


def test_statistics_are_those_of_numpy_where_cells_are_missing():
    rng = np.random.default_rng(2)
    means = rng.normal(size=(7, 2, 3))
    means[2, :, 1] = np.nan
    means[1:, :, 2] = np.nan
    found = statistics_of(means)
    np.testing.assert_allclose(found[0], np.nanmean(means, axis=0), rtol=1e-13)
    np.testing.assert_allclose(
        found[1][:, :2], np.nanstd(means[..., :2], axis=0, ddof=1), rtol=1e-13
    )
    off = np.abs(means - np.nanmean(means, axis=0))[..., :2]
    np.testing.assert_allclose(
        found[2][:, :2], np.nanmax(off, axis=0) / found[1][:, :2], rtol=1e-13
    )
    assert np.isnan(found[1:][..., 2]).all()


def test_of_two_subjects_neither_is_the_farthest():
    """Both always lie half their distance from the mean: that says nothing of either."""
    found = statistics_of(np.array([1.0, 3.0]).reshape(2, 1, 1))[:, 0, 0]
    np.testing.assert_allclose(found[:2], [2.0, np.sqrt(2.0)], rtol=1e-15)
    assert np.isnan(found[2])


@pytest.mark.parametrize("name", ["balanced", "missing cells", "trials"])
def test_replicated_statistics_follow_their_exact_laws(name):
    rng = np.random.default_rng(3)
    study, density, _, subjects = prepared(name, rng)
    draws = 20_000
    point = 0.5 * rng.normal(size=density.dimension)
    drawn = statistics_of(np.concatenate([*new_studies(subjects, np.tile(point, (draws, 1)), rng)]))
    scales = density.layout.scales(np.repeat(point[:, None], 2, axis=1))
    law = density.locations(scales)
    mean, error = np.stack(law.mean)[..., 0], np.stack(law.covariance.diagonal())[..., 0]
    spread = np.stack(density.population(scales).diagonal())[..., 0]
    if "sigma_e" in scales.named:
        spread = spread + scales.named["sigma_e"][..., 0] ** 2 / 3.0
    n = np.isfinite(study.statistics.cell_means).sum(axis=0)
    # Five standard errors over some 24 numbers.
    np.testing.assert_array_less(
        np.abs(drawn[:, 0].mean(axis=0) - mean), 5 * np.sqrt((error + spread / n) / draws)
    )
    ratio = drawn[:, 0].var(axis=0) / (error + spread / n)
    np.testing.assert_array_less(np.abs(ratio - 1.0), 5 * np.sqrt(2.0 / draws))
    square = drawn[:, 1] ** 2
    np.testing.assert_array_less(
        np.abs(square.mean(axis=0) / spread - 1.0), 5 * np.sqrt(2.0 / (n - 1) / draws)
    )
    # The farthest subject of a normal sample, whatever its mean and SD.
    plain = rng.normal(size=(draws, n[0, 0]))
    off = np.abs(plain - plain.mean(axis=1, keepdims=True)).max(axis=1) / plain.std(axis=1, ddof=1)
    assert stats.ks_2samp(off, drawn[:, 2, 0, 0]).pvalue > 1e-4


def test_an_outlier_that_was_planted_is_the_farthest_subject():
    rng = np.random.default_rng(4)
    study, *_ = prepared("balanced", rng)
    response = study.response.copy()
    response[(study.subject == 4) & (study.environment == 2)] += 25.0
    moved = designs.from_trials(
        response,
        study.subject,
        study.environment,
        study.x,
        parameters=study.statistics.parameters,
        environments=study.statistics.environments,
        subjects=study.statistics.subjects,
    )
    observed = statistics_of(moved.cell_means)[2]
    density = CollapsedDensity(moved)
    subjects = SubjectDensity(density, response, study.subject, study.environment)
    studies = new_studies(subjects, np.zeros((4000, density.dimension)), rng)
    drawn = statistics_of(np.concatenate([*studies]))[:, 2]
    above = (drawn > observed).mean(axis=0)
    assert (above[:, 2] < 0.005).all()
    assert (above[:, [0, 1, 3]] > 0.005).all()
