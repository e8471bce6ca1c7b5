"""The model nutpie samples is percept's: its locations integrated out, densities differ by one
constant."""

import numpy as np
import pytest
from scipy import optimize, special, stats

from percept.inference.model import linear_posterior
from reports.benchmark.nutpie import (
    CONFIDENCE,
    SHARE,
    limits_of_draws,
    observed,
    plain_model,
    share_half_widths,
)
from reports.benchmark.simulated import StudyDesign, simulated

LATENT = ("alpha", "gamma", "own_tau", "z_tau", "z_u")


def law(name):
    """Prior of an unknown that is not a location."""
    if name.startswith("half_"):
        return stats.beta(2, 2)
    if name.startswith("log_s"):
        return stats.norm(np.log(0.1 if name.endswith("_e") else 0.2), 1.0)
    if name.startswith("kappa"):
        return stats.norm(0.0, 0.5)
    if name.startswith("z"):
        return stats.norm()
    return stats.halfnorm(scale=1.0 if name.startswith("omega") else 0.5)


@pytest.fixture(params=["k and b, irregular", "k, irregular", "k and b, one trial"])
def study(request):
    one = "one trial" in request.param
    parameters = ("k", "b") if "b" in request.param else ("k",)
    trials, missing = ((1, 1), 0.0) if one else ((1, 3), 0.2)
    return simulated(StudyDesign(4, 3, trials, 1.0, missing=missing, parameters=parameters), 3)


def integrated(quadratic, shapes):
    """Log of the integral of exp(quadratic) over all unknowns: a quadratic is known from its
    values."""
    sizes = [int(np.prod(shape)) for shape in shapes.values()]
    total = sum(sizes)

    def value(vector):
        parts = np.split(vector, np.cumsum(sizes)[:-1])
        return quadratic({n: p.reshape(s) for (n, s), p in zip(shapes.items(), parts, strict=True)})

    unit, zero = np.eye(total), value(np.zeros(total))
    ahead = np.array([value(e) for e in unit])
    behind = np.array([value(-e) for e in unit])
    slope = 0.5 * (ahead - behind)
    curvature = np.diag(ahead + behind - 2.0 * zero)
    for i in range(total):
        for j in range(i):
            both = value(unit[i] + unit[j]) - ahead[i] - ahead[j] + zero
            curvature[i, j] = curvature[j, i] = both
    top = 0.5 * slope @ np.linalg.solve(-curvature, slope)
    return zero + top + 0.5 * total * np.log(2.0 * np.pi) - 0.5 * np.linalg.slogdet(-curvature)[1]


@pytest.mark.parametrize("centred", [False, True])
@pytest.mark.filterwarnings("ignore")  # of the libraries, about themselves
def test_integrated_over_the_locations_it_is_the_collapsed_density(study, centred):
    pytest.importorskip("pymc")
    statistics = study.trials.statistics
    model = plain_model(observed(study), centred=centred)
    compiled = model.compile_logp(jacobian=False)
    density = linear_posterior.plain_model(statistics)
    points = 0.5 * np.random.default_rng(4).standard_normal((4, len(density.names)))
    collapsed = density.log_likelihood(density.linear_scales(points).cells)
    scales = density.scales(points)
    variables = {variable.name: model.rvs_to_values[variable] for variable in model.free_RVs}
    shapes = {name: tuple(variables[name].type.shape) for name in LATENT if name in variables}
    differences = []
    for draw in range(len(points)):
        named = {name: values[draw] for name, (_, values) in scales.items()}
        given, prior_of_sigma = {name: named[name] for name in ("tau", "sigma_u")}, 0.0
        for suffix in ("", "_e") if "sigma_e" in named else ("",):
            log_s = np.log(named["s" + suffix])
            omega, kappa = named["omega" + suffix], named["kappa" + suffix]
            line = log_s[:, None] + kappa[:, None] * statistics.x
            given |= {"log_s" + suffix: log_s, "kappa" + suffix: kappa, "omega" + suffix: omega}
            log_sigma = np.log(named["sigma" + suffix])
            if centred:
                given["log_sigma" + suffix] = log_sigma
                prior_of_sigma += stats.norm.logpdf(log_sigma, line, omega[:, None]).sum()
            else:
                given["z" + suffix] = (log_sigma - line) / omega[:, None]
        given |= {
            f"half_{name}": 0.5 * (1 + value) for name, value in named.items() if name[:3] == "rho"
        }

        def log_density(latents, given=given):
            point = {}
            for name, variable in variables.items():
                value = (given | latents)[name]
                transform = variable.name.removeprefix(name)
                point[variable.name] = {
                    "_log__": np.log, "_logodds__": lambda v: np.log(v / (1.0 - v)),
                }.get(transform, np.asarray)(value)  # fmt: skip
            return float(compiled(point))

        own = {name: value for name, value in given.items() if not name.startswith("log_sigma")}
        prior = prior_of_sigma + sum(law(name).logpdf(value).sum() for name, value in own.items())
        differences.append(integrated(log_density, shapes) - prior - collapsed[draw])
    assert differences == pytest.approx(np.full(len(points), differences[0]), abs=1e-6)


@pytest.mark.parametrize("off", [0.0, 1e-9, 0.01, 0.5, 3.0, 40.0])
@pytest.mark.parametrize("share", [0.5, 0.99, 0.9999])
def test_share_half_width_is_the_root(off, share):
    spread = 0.3

    def missing(h):
        return special.ndtr((off - h) / spread) + special.ndtr((-off - h) / spread) - (1.0 - share)

    expected = optimize.brentq(missing, 0.0, off + 10.0, xtol=1e-15, rtol=1e-15)
    # Of opposite signs alike.
    found = share_half_widths(np.array([off, -off]), np.array([spread, spread]), share)
    assert found == pytest.approx([expected, expected], rel=1e-11)


def test_limits_of_independent_draws_of_a_known_law():
    """Means N(0.2, 0.1²), spread 0.5: quantiles are known, and so is the size of the errors."""
    rng = np.random.default_rng(11)
    chains, draws, cells = 4, 3000, 20
    beta = 0.2 + 0.1 * rng.standard_normal((chains, draws, cells))
    spread = np.full(beta.shape, 0.5) * np.exp(1e-12 * rng.standard_normal(beta.shape))
    value, error, effective = limits_of_draws(beta, spread, rng)
    z = stats.norm.isf(0.005)
    wide = np.hypot(0.1, 0.5)
    exact = 0.2 + z * np.array([-0.1, 0.1, -wide, wide])
    apart = (value[:2].reshape(4, cells) - exact[:, None]) / error[:2].reshape(4, cells)
    # 80 standardised errors: their mean square has an SD of sqrt(2/80), and more as they are
    # estimated.
    assert np.mean(apart**2) == pytest.approx(1.0, abs=5 * 1.2 * np.sqrt(2 / 80))
    off = stats.norm.isf(0.5 * (1 - CONFIDENCE)) * 0.1
    half = share_half_widths(np.array(off), np.array(0.5), SHARE)
    assert np.abs((value[2, 1] - value[2, 0]) / 2 - half).max() < 5 * error[2].max()
    assert effective == pytest.approx(chains * draws, rel=0.2)


def test_errors_see_autocorrelation():
    rng = np.random.default_rng(12)
    noise = rng.standard_normal((4, 4000, 2))
    slow = np.zeros_like(noise)
    for t in range(1, noise.shape[1]):
        slow[:, t] = 0.9 * slow[:, t - 1] + np.sqrt(1 - 0.81) * noise[:, t]
    spread = np.exp(0.1 * noise)
    (_, quick_error, quick), (_, error, found) = (
        limits_of_draws(draws, spread, rng) for draws in (noise, slow)
    )
    # The mean of an AR(1) with 0.9 has (1 + 0.9)/(1 - 0.9) = 19 times the variance of independent
    # draws.
    assert found < quick / 6
    assert (error[0] > 1.7 * quick_error[0]).all()
