"""The plain joint density against scipy's and percept's collapsed one; limits from draws of known laws."""

from pathlib import Path

import numpy as np
import pytest
from scipy import optimize, special, stats

from percept.bench.peers.engines import percept_model
from percept.bench.peers.model import (
    CONFIDENCE,
    SHARE,
    PlainDensity,
    Responses,
    limits_of_draws,
    log_joint,
    population,
    share_half_widths,
)
from percept.errors import UsageError
from percept.inference.hierarchy.scales import Scales


def at(values, draw):
    return {name: value[..., draw] for name, value in values.items()}


def pair(sd, rho):
    return np.array([[sd[0] ** 2, rho * sd[0] * sd[1]], [rho * sd[0] * sd[1], sd[1] ** 2]])


def by_scipy(study, one):
    """The same density, law by law."""
    x = study.decades
    total = stats.norm.logpdf(one["alpha"]).sum() + stats.norm.logpdf(one["gamma"], scale=0.25).sum()
    total += (
        stats.norm.logpdf(one["log_s"], np.log(0.2)).sum() + stats.norm.logpdf(one["kappa"], 0, 0.5).sum()
    )
    for name, scale in {"tau": 0.5, "sigma_u": 0.5, "omega": 1.0}.items():
        total += stats.halfnorm.logpdf(one[name], scale=scale).sum()
    for name in ("rho_u", "rho_w"):
        total += stats.beta.logpdf(one[name], 2, 2, loc=-1, scale=2)
    total += stats.norm.logpdf(one["delta"], scale=one["tau"][:, None]).sum()
    trend = one["log_s"][:, None] + one["kappa"][:, None] * x
    total += stats.norm.logpdf(one["log_sigma"], trend, one["omega"][:, None]).sum()
    shared = pair(one["sigma_u"], one["rho_u"])
    total += stats.multivariate_normal.logpdf(one["u"].T, cov=shared).sum()
    beta = one["alpha"][:, None] + one["gamma"][:, None] * x + one["delta"]
    for y, i, j in zip(study.response, study.subject, study.environment, strict=True):
        cov = pair(np.exp(one["log_sigma"][:, j]), one["rho_w"])
        total += stats.multivariate_normal.logpdf(y, beta[:, j] + one["u"][:, i], cov)
    return total


def test_joint_density_is_the_product_of_its_laws(study, unknowns):
    found = log_joint(study, unknowns)
    for draw in range(len(found)):
        assert found[draw] == pytest.approx(by_scipy(study, at(unknowns, draw)), rel=1e-12)


def locations_given_scales(study, one):
    """Prior covariance of (alpha, gamma, delta, u), design of the data on them, and noise covariance."""
    subjects, environments = study.subjects, study.environments
    count = 2 + 2 + 2 * environments + 2 * subjects
    prior = np.zeros((count, count))
    prior[:4, :4] = np.diag([1.0, 1.0, 0.25**2, 0.25**2])
    first = 4 + 2 * environments
    prior[4:first, 4:first] = np.diag(np.repeat(one["tau"] ** 2, environments))
    prior[first:, first:] = np.kron(pair(one["sigma_u"], one["rho_u"]), np.eye(subjects))
    rows = []
    noise = []
    for i, j in zip(study.subject, study.environment, strict=True):
        for p in range(2):
            row = np.zeros(count)
            row[[p, 4 + p * environments + j, first + p * subjects + i]] = 1.0
            row[2 + p] = study.decades[p, j]
            rows.append(row)
        noise.append(pair(np.exp(one["log_sigma"][:, j]), one["rho_w"]))
    design, covariance = np.array(rows), np.zeros((len(rows), len(rows)))
    for m, block in enumerate(noise):
        covariance[2 * m : 2 * m + 2, 2 * m : 2 * m + 2] = block
    return prior, design, covariance


def test_percepts_density_is_the_joint_density_with_the_locations_integrated_out(sessions, study, unknowns):
    """Joint density over the locations' conditional one is the collapsed density, at any locations."""
    density = percept_model(sessions)[0].density
    for draw in range(unknowns["rho_u"].size):
        one = at(unknowns, draw)
        prior, design, noise = locations_given_scales(study, one)
        y = study.response.ravel()
        gain = prior @ design.T @ np.linalg.inv(design @ prior @ design.T + noise)
        latents = np.concatenate([np.ravel(one[name]) for name in ("alpha", "gamma", "delta", "u")])
        conditional = stats.multivariate_normal.logpdf(latents, gain @ y, prior - gain @ design @ prior)
        of_scales = by_scipy(study, one) - conditional
        prior_of_scales = sum(
            stats.halfnorm.logpdf(one[name], scale=scale).sum()
            for name, scale in {"tau": 0.5, "sigma_u": 0.5, "omega": 1.0}.items()
        )
        prior_of_scales += sum(stats.beta.logpdf(one[name], 2, 2, -1, 2) for name in ("rho_u", "rho_w"))
        prior_of_scales += stats.norm.logpdf(one["log_s"], np.log(0.2)).sum()
        prior_of_scales += stats.norm.logpdf(one["kappa"], scale=0.5).sum()
        trend = one["log_s"][:, None] + one["kappa"][:, None] * study.decades
        prior_of_scales += stats.norm.logpdf(one["log_sigma"], trend, one["omega"][:, None]).sum()
        found = density.log_likelihood(scales_of(density, one))[0]
        assert found == pytest.approx(of_scales - prior_of_scales, abs=1e-7)


def scales_of(density, one):
    """percept's record of the same scales, made without its coordinates."""
    from percept.inference.hierarchy.blocks import block

    def column(value):
        return np.asarray(value)[..., None]

    sigma = np.exp(one["log_sigma"])
    return Scales(
        between=block(
            tuple(column(row) for row in sigma), column(one["rho_w"]), column(1 - abs(one["rho_w"]))
        ),
        shared=block(
            tuple(column(value) for value in one["sigma_u"]),
            column(one["rho_u"]),
            column(1 - abs(one["rho_u"])),
        ),
        trial=None,
        tau=tuple(column(value) for value in one["tau"]),
        named={},
        log_prior=np.zeros(1),
    )


#: Log Jacobian of the coordinates that are not the unknown itself.
MEASURED_ELSE = dict.fromkeys(("tau", "sigma_u", "omega"), lambda u: u)
MEASURED_ELSE |= dict.fromkeys(("rho_u", "rho_w"), lambda u: -2.0 * np.log(np.cosh(u)))


def test_coordinates_carry_their_jacobians(study):
    """The integral over one coordinate alone does not depend on how it is measured."""
    density = PlainDensity(study)
    start = density.start(1, np.random.default_rng(3))[0]
    names = [name for name, size in density.sizes.items() for _ in range(size)]
    for name in ("tau", "rho_w"):
        place = names.index(name)
        grid = np.linspace(-12.0, 6.0, 6001) if name == "tau" else np.linspace(-9.0, 9.0, 6001)
        points = np.repeat(start[None], grid.size, axis=0)
        points[:, place] = grid
        over_coordinate = np.trapezoid(np.exp(density(points) - density(points).max()), grid)
        values = density.unknowns(points)
        native = values[name][0] if name == "tau" else values[name]
        others = [i for i, other in enumerate(names) if other in MEASURED_ELSE and i != place]
        fixed = sum(MEASURED_ELSE[names[i]](start[i]) for i in others)
        plain = np.exp(log_joint(study, values) + fixed - density(points).max())
        order = np.argsort(native)
        assert over_coordinate == pytest.approx(np.trapezoid(plain[order], native[order]), rel=1e-4)


def test_far_points_have_no_density(study):
    density = PlainDensity(study)
    points = np.zeros((3, density.dimension))
    points[0] = 1e4
    points[1] = -1e4
    assert np.isneginf(density(points)[:2]).all()
    assert np.isfinite(density(points)[2])


def test_population_of_a_cell(study, unknowns):
    beta, spread = population(unknowns, study.decades)
    one = at(unknowns, 4)
    p, j = 1, 3
    expected = one["alpha"][p] + one["gamma"][p] * study.decades[p, j] + one["delta"][p, j]
    cell = p * study.environments + j
    assert beta[4, cell] == pytest.approx(expected, rel=1e-14)
    variance = one["sigma_u"][p] ** 2 + np.exp(2 * one["log_sigma"][p, j])
    assert spread[4, cell] == pytest.approx(np.sqrt(variance), rel=1e-14)


def test_repeated_trials_are_refused(tmp_path, sessions):
    lines = Path(sessions).read_text(encoding="utf-8").splitlines()
    again = lines[1].split(",")
    again[5] = "2"
    file = tmp_path / "twice.csv"
    file.write_text("\n".join([*lines, ",".join(again)]) + "\n", encoding="utf-8")
    with pytest.raises(UsageError, match="several trials in one environment"):
        Responses.of_sessions(file)


def test_responses_survive_a_file(tmp_path, study):
    study.save(tmp_path / "study.npz")
    back = Responses.load(tmp_path / "study.npz")
    for name in ("response", "subject", "environment", "decades"):
        assert np.array_equal(getattr(back, name), getattr(study, name))


@pytest.mark.parametrize("off", [0.0, 1e-9, 0.01, 0.5, 3.0, 40.0])
@pytest.mark.parametrize("share", [0.5, 0.99, 0.9999])
def test_share_half_width_is_the_root(off, share):
    spread = 0.3

    def missing(h):
        return special.ndtr((off - h) / spread) + special.ndtr((-off - h) / spread) - (1.0 - share)

    expected = optimize.brentq(missing, 0.0, off + 10.0, xtol=1e-15, rtol=1e-15)
    # Of opposite signs alike, and a numpy array of one is as good as a scalar.
    found = share_half_widths(np.array([off, -off]), np.array([spread, spread]), share)
    assert found == pytest.approx([expected, expected], rel=1e-11)


def test_limits_of_independent_draws_of_a_known_law():
    """Means N(0.2, 0.1²), spread 0.5: quantiles are known, and so is the size of the errors."""
    rng = np.random.default_rng(11)
    chains, draws, cells = 4, 3000, 20
    beta = 0.2 + 0.1 * rng.standard_normal((chains, draws, cells))
    spread = np.full(beta.shape, 0.5) * np.exp(1e-12 * rng.standard_normal(beta.shape))
    found = limits_of_draws(beta, spread, rng)
    z = stats.norm.isf(0.005)
    wide = np.hypot(0.1, 0.5)
    exact = 0.2 + z * np.array([-0.1, 0.1, -wide, wide])
    apart = (found.value[:2].reshape(4, cells) - exact[:, None]) / found.error[:2].reshape(4, cells)
    # 80 standardised errors: their mean square has an SD of sqrt(2/80), and more as they are estimated.
    assert np.mean(apart**2) == pytest.approx(1.0, abs=5 * 1.2 * np.sqrt(2 / 80))
    off = stats.norm.isf(0.5 * (1 - CONFIDENCE)) * 0.1
    half = share_half_widths(np.array(off), np.array(0.5), SHARE)
    assert np.abs((found.value[2, 1] - found.value[2, 0]) / 2 - half).max() < 5 * found.error[2].max()
    assert found.effective == pytest.approx(chains * draws, rel=0.2)


def test_errors_see_autocorrelation():
    rng = np.random.default_rng(12)
    noise = rng.standard_normal((4, 4000, 2))
    slow = np.zeros_like(noise)
    for t in range(1, noise.shape[1]):
        slow[:, t] = 0.9 * slow[:, t - 1] + np.sqrt(1 - 0.81) * noise[:, t]
    spread = np.exp(0.1 * noise)
    quick, found = limits_of_draws(noise, spread, rng), limits_of_draws(slow, spread, rng)
    # The mean of an AR(1) with 0.9 has (1 + 0.9)/(1 - 0.9) = 19 times the variance of independent draws.
    assert found.effective < quick.effective / 6
    assert (found.error[0] > 1.7 * quick.error[0]).all()
