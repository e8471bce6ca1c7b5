"""Density of the coordinates against scipy's priors of the variables and a numerical Jacobian."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from percept.errors import UsageError
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.priors import MEANINGS, Priors
from percept.inference.hierarchy.scales import Options
from tests.inference.hierarchy import dense_twin, designs

OTHER = Priors(
    alpha_sd=2.0,
    gamma_sd=0.4,
    tau_scale=0.2,
    sigma_u_scale=0.9,
    log_s_mean=-1.0,
    log_s_sd=0.6,
    kappa_sd=0.3,
    omega_scale=0.7,
    rho_shape=3.5,
    log_s_e_mean=-3.0,
    log_s_e_sd=0.8,
    kappa_e_sd=0.2,
    omega_e_scale=0.4,
)


def log_jacobian(density, u, *, common_spread):
    """log abs det of the map from coordinates to variables, by central differences of fourth
    order."""

    def variables(points):
        return dense_twin.prior_variables(
            density.layout.scales(points).named, common_spread=common_spread
        )

    step = 1e-3
    offsets = step * np.eye(u.size)
    near = variables(u[:, None] + offsets) - variables(u[:, None] - offsets)
    far = variables(u[:, None] + 2 * offsets) - variables(u[:, None] - 2 * offsets)
    return np.linalg.slogdet((8 * near - far) / (12 * step))[1]


SMALLER = (
    Options(),
    Options(weber=True),
    Options(subject_effect=False),
    Options(common_spread=True),
)


@pytest.mark.parametrize("priors", [Priors(), OTHER], ids=["default", "other"])
@pytest.mark.parametrize("name", designs.NAMES)
def test_prior_density_times_jacobian(name, priors):
    rng = np.random.default_rng(3)
    study = designs.study(name, rng)
    for options in (
        Options(),
        Options(weber=True),
        Options(subject_effect=False),
        Options(common_spread=True),
    ):
        density = CollapsedDensity(study.statistics, priors, options)
        points = rng.normal(size=(density.dimension, 4))
        scales = density.layout.scales(points)
        for w in range(4):
            wanted = dense_twin.log_prior(scales.named, study.x, w, priors)
            wanted += log_jacobian(density, points[:, w], common_spread=options.common_spread)
            assert abs(scales.log_prior[w] - wanted) < 1e-8 * (1 + abs(wanted)), (options, w)


@pytest.mark.parametrize("name", ["balanced", "unequal trials", "k only"])
def test_posterior_is_likelihood_plus_prior(name):
    rng = np.random.default_rng(8)
    study = designs.study(name, rng)
    density = CollapsedDensity(study.statistics, OTHER)
    points = rng.normal(size=(5, density.dimension))
    scales = density.layout.scales(np.ascontiguousarray(points.T))
    for w in range(5):
        likelihood = dense_twin.log_likelihood(
            study.response,
            study.subject,
            study.environment,
            study.x,
            scales,
            w,
            alpha_sd=2.0,
            gamma_sd=0.4,
        )
        wanted = likelihood + scales.log_prior[w]
        assert abs(density(points)[w] - wanted) < 1e-9 * (1 + abs(wanted))


def test_coordinates_drawn_normal_give_the_priors():
    """Kolmogorov-Smirnov on every scale that has no data in its coordinate's map."""
    study = designs.study("trials", np.random.default_rng(2))
    density = CollapsedDensity(study.statistics, OTHER)
    named = density.layout.scales(
        np.random.default_rng(4).normal(size=(density.dimension, 4000))
    ).named
    laws = {
        "tau": stats.halfnorm(scale=0.2),
        "sigma_u": stats.halfnorm(scale=0.9),
        "omega": stats.halfnorm(scale=0.7),
        "omega_e": stats.halfnorm(scale=0.4),
        **{name: stats.beta(3.5, 3.5, loc=-1, scale=2) for name in ("rho_w", "rho_e", "rho_u")},
    }
    values = [(name, row) for name in laws for row in np.atleast_2d(named[name])]
    for name, row in values:
        assert stats.kstest(row, laws[name].cdf).pvalue > 1e-3 / len(values), name


def test_names_say_which_coordinate_is_which():
    density = CollapsedDensity(designs.study("trials", np.random.default_rng(0)).statistics)
    base = np.zeros((density.dimension, 1))
    named = density.layout.scales(base).named
    for i, label in enumerate(density.names):
        moved = base.copy()
        moved[i] = 0.5
        changed = {
            k
            for k, v in density.layout.scales(moved).named.items()
            if not np.array_equal(v, named[k])
        }
        key = label.split("[")[0].replace("log_s", "s")
        assert key in changed
        # Spreads move with omega, and their trend with both; decades off their centre tie s to
        # kappa.
        suffix = "_e" if key.endswith("_e") else ""
        trend = {"s" + suffix, "kappa" + suffix}
        follows = {"omega": {"sigma" + suffix} | trend, "sigma": trend, "s": trend, "kappa": trend}
        follows = follows.get(key.removesuffix("_e"), set())
        assert changed <= {key} | follows


def test_options_remove_their_coordinates():
    statistics = designs.study("balanced", np.random.default_rng(0)).statistics

    def heads(options):
        return {n.split("[")[0] for n in CollapsedDensity(statistics, options=options).names}

    everything = {"sigma", "log_s", "kappa", "omega", "rho_w", "sigma_u", "rho_u", "tau"}
    assert heads(Options()) == everything
    assert heads(Options(weber=True)) == everything - {"kappa"}
    assert heads(Options(subject_effect=False)) == everything - {"sigma_u", "rho_u"}
    assert heads(Options(common_spread=True)) == everything - {"sigma", "omega"}
    assert CollapsedDensity(statistics).dimension == 22 - 2  # 4 environments, not 5


def test_priors_in_force_are_those_whose_change_moves_the_density():
    """For every design and option, and for every prior, against the density itself."""
    rng = np.random.default_rng(3)
    for name in ("balanced", "trials", "one parameter", "one environment"):
        statistics = designs.study(name, rng).statistics
        for options in (
            Options(),
            Options(weber=True),
            Options(subject_effect=False),
            Options(common_spread=True),
        ):
            plain = CollapsedDensity(statistics, options=options)
            points = rng.normal(size=(3, plain.dimension))
            in_force = plain.layout.priors_in_force
            for field in dataclasses.fields(Priors):
                value = getattr(Priors(), field.name)
                changed = Priors(**{field.name: 1.5 * value})
                moved = not np.array_equal(
                    CollapsedDensity(statistics, changed, options)(points), plain(points)
                )
                assert moved == (field.name in in_force), (name, options, field.name)
                assert not moved or in_force[field.name] == value


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(Priors)])
def test_priors_refuse_what_is_no_scale(field):
    assert field in MEANINGS
    with pytest.raises(UsageError, match=rf"{field} = nan: a prior must be finite"):
        Priors(**{field: np.nan})
    if not field.endswith("_mean"):
        with pytest.raises(UsageError, match=rf"{field} = 0.0: a prior scale must be positive"):
            Priors(**{field: 0.0})
