"""The model nutpie samples is percept's: its locations integrated out, densities differ by one
constant."""

import numpy as np
import pytest
from scipy import stats

from reports.benchmark.simulated import StudyDesign, simulated
from reports.peers.nutpie import plain_model
from reports.studies import model_of

LATENT = ("alpha", "gamma", "own_tau", "z_u")


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
    return simulated(StudyDesign(4, 3, trials, missing=missing, parameters=parameters), 3)


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


@pytest.mark.filterwarnings("ignore")  # of the libraries, about themselves
def test_integrated_over_the_locations_it_is_the_collapsed_density(study):
    pytest.importorskip("pymc")
    model = plain_model(study)
    compiled = model.compile_logp(jacobian=False)
    density = model_of(study)
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
            line = log_s[:, None] + kappa[:, None] * study.x
            given |= {"log_s" + suffix: log_s, "kappa" + suffix: kappa, "omega" + suffix: omega}
            log_sigma = np.log(named["sigma" + suffix])
            given["log_sigma" + suffix] = log_sigma
            prior_of_sigma += stats.norm.logpdf(log_sigma, line, omega[:, None]).sum()
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
