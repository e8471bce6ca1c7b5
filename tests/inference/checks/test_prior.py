"""Prior draws against scipy's laws; densities of priors against scipy's densities."""

import numpy as np
import pytest
from scipy import stats

from percept.inference.checks.prior import GROUPS, draw_prior, draw_trend, log_prior
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.scales import Options
from tests.inference.checks.test_subjects import prepared
from tests.inference.hierarchy import designs
from tests.inference.hierarchy.test_prior import OTHER


def laws(priors):
    rho = stats.beta(priors.rho_shape, priors.rho_shape, loc=-1.0, scale=2.0)
    half = {name: stats.halfnorm(scale=getattr(priors, f"{name}_scale")) for name in ("tau", "sigma_u")}
    half |= {name: stats.halfnorm(scale=getattr(priors, f"{name}_scale")) for name in ("omega", "omega_e")}
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
    named, means, users = draw_prior(density, draws, rng)
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
        sd = np.sqrt(OTHER.alpha_sd**2 + OTHER.gamma_sd**2 * study.x[0, 0] ** 2 + named["tau"][1][:, 0] ** 2)
        # Given tau the location is normal; the data, which have other scales, do not enter.
        assert stats.kstest(means[:, 0] / sd, stats.norm.cdf).pvalue > 1e-4
        log_sigma = np.log(named["sigma"][1][:, 0, 0])
        centre = np.log(named["s"][1][:, 0]) + named["kappa"][1][:, 0] * study.x[0, 0]
        assert stats.kstest((log_sigma - centre) / named["omega"][1][:, 0], stats.norm.cdf).pvalue > 1e-4
    spread = named["sigma"][1][:, 0, 0] ** 2 + (named["sigma_u"][1][:, 0] ** 2 if "sigma_u" in named else 0.0)
    assert stats.kstest((users - means)[:, 0] / np.sqrt(spread), stats.norm.cdf).pvalue > 1e-4


def test_users_of_one_draw_are_correlated_as_the_draw_says():
    rng = np.random.default_rng(32)
    density = CollapsedDensity(designs.study("one environment", rng).statistics)
    named, means, users = draw_prior(density, 20_000, rng)
    off = (users - means) / named["sigma"][1][:, :, 0]
    rho = named["rho_w"][1]
    left = (off[:, 1] - rho * off[:, 0]) / np.sqrt(1.0 - rho**2)
    assert stats.kstest(left, stats.norm.cdf).pvalue > 1e-4
    assert abs(np.corrcoef(left, off[:, 0])[0, 1]) < 5 / np.sqrt(20_000)


@pytest.mark.parametrize("name", ["trials", "one environment, trials", "k only"])
def test_log_prior_is_scipys(name):
    rng = np.random.default_rng(33)
    study = designs.study(name, rng)
    density = CollapsedDensity(study.statistics, OTHER)
    scales = density.layout.scales(rng.normal(size=(density.dimension, 5)))
    beta = rng.normal(size=(*study.x.shape, 5))
    found = log_prior(density, scales, beta, np.random.default_rng(1))
    known = laws(OTHER)
    for key, (_, value) in found.items():
        if key in ("tau", "sigma_u", "omega", "omega_e", "kappa", "kappa_e", "rho_w", "rho_u", "rho_e"):
            expected = known[key].logpdf(np.moveaxis(scales.named[key], -1, 0))
        elif key in ("s", "s_e", "sigma", "sigma_e"):
            end = "_e" if key.endswith("_e") else ""
            law = stats.norm(getattr(OTHER, f"log_s{end}_mean"), getattr(OTHER, f"log_s{end}_sd"))
            expected = law.logpdf(np.log(np.moveaxis(scales.named[key], -1, 0)))
        elif "tau" in scales.named:
            alpha, gamma = draw_trend(density, scales, beta, np.random.default_rng(1))
            drawn, sd = (alpha, OTHER.alpha_sd) if key == "alpha" else (gamma, OTHER.gamma_sd)
            expected = stats.norm.logpdf(drawn.T, 0.0, sd)
        else:
            assert key == "alpha"
            expected = stats.norm.logpdf(beta[:, 0].T, 0.0, OTHER.alpha_sd)
        np.testing.assert_allclose(value, expected, rtol=1e-10, err_msg=key)
    assert set(found) <= {key for group in GROUPS.values() for key in group}


def test_trend_given_locations_is_the_dense_regression():
    rng = np.random.default_rng(34)
    study, density, scales, _ = prepared("balanced", rng, Options(), draws=4)
    beta = rng.normal(size=(*study.x.shape, 4))
    alpha, gamma = draw_trend(density, scales, beta)
    priors = density.priors
    for p, x in enumerate(study.x):
        design = np.stack([np.ones_like(x), x], axis=1)
        for w in range(4):
            tau = scales.named["tau"][p, w]
            precision = design.T @ design / tau**2 + np.diag([priors.alpha_sd**-2.0, priors.gamma_sd**-2.0])
            mean = np.linalg.solve(precision, design.T @ beta[p, :, w] / tau**2)
            np.testing.assert_allclose([alpha[p, w], gamma[p, w]], mean, rtol=1e-10)
    many = density.layout.scales(np.zeros((density.dimension, 20_000)))
    drawn = draw_trend(density, many, np.repeat(beta[..., :1], 20_000, axis=2), rng)
    tau = many.named["tau"][0, 0]
    precision = len(study.x[0]) / tau**2 + priors.alpha_sd**-2.0
    assert drawn[0][0].var() * precision == pytest.approx(1.0, abs=5 * np.sqrt(2.0 / 20_000))
