"""Priors and statistics against exact laws and simulated studies."""

import numpy as np
import pytest
from scipy import stats

from percept.inference.model.predictions import draw_prior
from percept.inference.predictive import (
    new_studies,
    statistics_of,
)
from tests.inference.checks.test_subjects import averages, opened
from tests.inference.model.designs import OTHER, made


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


@pytest.mark.parametrize("name", ["plain, trials", "one cell", "one quantity"])
def test_draws_have_their_priors(name):
    rng = np.random.default_rng(31)
    study = made(name, priors=OTHER)
    draws = 20_000
    named, means = draw_prior(study.model, draws, rng)
    known = laws(OTHER)
    for key, (dimensions, value) in named.items():
        assert len(dimensions) == value.ndim - 1
        if key in known:
            assert stats.kstest(value.reshape(draws, -1)[:, 0], known[key].cdf).pvalue > 1e-4, key
    if name == "one cell":
        level = stats.lognorm(OTHER.log_s_sd, scale=np.exp(OTHER.log_s_mean))
        assert stats.kstest(named["sigma"][1][:, 0, 0], level.cdf).pvalue > 1e-4
        assert stats.kstest(means[:, 0], stats.norm(0.0, OTHER.alpha_sd).cdf).pvalue > 1e-4
    else:
        sd = np.sqrt(
            OTHER.alpha_sd**2
            + OTHER.gamma_sd**2 * study.study.x[0, 0] ** 2
            + named["tau"][1][:, 0] ** 2
        )
        # Given tau the location is normal; the data, which have other scales, do not enter.
        assert stats.kstest(means[:, 0] / sd, stats.norm.cdf).pvalue > 1e-4
        log_sigma = np.log(named["sigma"][1][:, 0, 0])
        centre = np.log(named["s"][1][:, 0]) + named["kappa"][1][:, 0] * study.study.x[0, 0]
        assert (
            stats.kstest((log_sigma - centre) / named["omega"][1][:, 0], stats.norm.cdf).pvalue
            > 1e-4
        )


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


@pytest.mark.parametrize(
    "name",
    ["plain", "plain, missing cells", "plain, trials", "three levels, missing cells",
     "subjects' trial SDs"],
)  # fmt: skip
def test_new_studies_scatter_as_the_model_says(name):
    """Means and variances of subjects' cell means over many studies from one set of scales."""
    study, subjects = opened(name)
    point = study.points(1, spread=0.5)
    count = 4000
    drawn = np.concatenate(
        list(new_studies(subjects, np.repeat(point, count, axis=0), np.random.default_rng(4)))
    )
    twin = study.twin(point)
    mean, covariance = twin.posterior()
    # Of new trials: the locations as the data leave them.
    prior = twin.loadings @ twin.locations[0] @ twin.loadings.T
    left = twin.loadings @ covariance[0] @ twin.loadings.T
    total = twin.observed[0] - prior + left
    for i in range(subjects.subjects):
        rows, cells = averages(study.study, i)
        own = np.tile(study.study.subject == i, twin.size)
        expected = rows @ (twin.loadings @ mean[0])[own]
        variance = np.diag(rows @ total[np.ix_(own, own)] @ rows.T)
        values = drawn[:, i][..., cells].reshape(count, -1)
        assert np.abs((values.mean(axis=0) - expected) / np.sqrt(variance / count)).max() < 4.5
        assert np.abs(values.var(axis=0) / variance - 1.0).max() < 4.5 * np.sqrt(2.0 / count)
        assert np.isnan(np.delete(drawn[0, i], cells, axis=1)).all()
