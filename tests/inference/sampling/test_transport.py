"""The transport: an exact Jacobian, a monotone spline, and a target that comes out nearly
normal."""

import dataclasses

import numpy as np
import pytest
from scipy import special, stats

from percept.inference.sampling.coordinates import Affine, Transported
from percept.inference.sampling.moves import ReferenceLaw
from percept.inference.sampling.transport import Transport
from tests.inference.sampling.targets import Normal


class Funnel(Normal):
    """x_0 widens x_1 and x_2 and bends x_3; x_4 is exponential."""

    def __init__(self):
        super().__init__(5)

    def exact(self, count, rng):
        x = rng.standard_normal((count, 5))
        x[:, 1:3] *= np.exp(0.7 * x[:, :1])
        x[:, 3] += 0.8 * x[:, 0] ** 2
        x[:, 4] = -np.log(special.ndtr(-x[:, 4]))
        return x

    def __call__(self, points):
        first = points[:, 0]
        value = stats.norm.logpdf(first) + stats.norm.logpdf(points[:, 3] - 0.8 * first**2)
        value += stats.norm.logpdf(points[:, 1:3], scale=np.exp(0.7 * first)[:, None]).sum(axis=1)
        return value + np.where(points[:, 4] > 0, -points[:, 4], -np.inf)


def efficiency(transported, count=20_000):
    """Effective share of importance draws."""
    law = ReferenceLaw(len(transported.names))
    z = law.draw(count, np.random.default_rng(3))
    log_weights = transported(z) - law.log_density(z)
    weights = np.exp(log_weights - log_weights.max())
    return weights.sum() ** 2 / (weights @ weights) / count


@pytest.fixture(scope="module")
def fitted():
    return Transport.fit(Funnel().exact(8000, np.random.default_rng(1)))


def test_jacobian_is_the_maps_own(fitted):
    assert len(fitted.drivers) >= 1
    z = 1.3 * np.random.default_rng(2).standard_normal((60, 5))
    _, found = fitted(z)
    step = 1e-5
    columns = [
        (fitted(z + step * unit)[0] - fitted(z - step * unit)[0]) / (2 * step) for unit in np.eye(5)
    ]
    wanted = np.linalg.slogdet(np.stack(columns, axis=2))[1]
    # A difference across the corner where a driver's effect ends, or the spline's, says nothing.
    close = np.abs(found - wanted) < 1e-6 * (1 + np.abs(wanted))
    assert close.mean() > 0.95


def test_finds_the_driver_and_what_it_does(fitted):
    assert fitted.drivers[0] == 0
    # log-spread of x_1 on the driver, on the scale of normal scores
    assert np.all(fitted.log_scale[1:3, 1] > 0.3)
    assert abs(fitted.log_scale[4, 1]) < 0.05
    assert fitted.mean[3, 2] > 0.2


def test_target_comes_out_nearly_normal():
    """On average over samples: how far one sample reaches into the funnel is chance."""
    target = Funnel()
    samples = [target.exact(8000, np.random.default_rng(seed)) for seed in range(1, 7)]
    affine = Affine.fit(samples[0], np.full(len(samples[0]), 1 / len(samples[0])))
    fitted = [efficiency(Transported(target, Transport.fit(sample))) for sample in samples]
    assert np.mean(fitted) > 0.5
    assert efficiency(Transported(target, affine)) < 0.3


def test_margins_of_few_normal_draws_are_straight_and_those_of_many_go_through_the_quantiles():
    """Of 300 draws the quantile at -3 errs by half a unit in each coordinate; straight lines err
    far less."""
    knots = np.tile(np.linspace(-3, 3, 13), (40, 1))
    sample = np.random.default_rng(5).standard_normal((300, 40))
    off = Transport.fit(sample).spline(knots)[0] - knots
    raw = np.quantile(sample, special.ndtr(knots[0]), axis=0).T - knots
    assert np.sqrt(np.mean(off[:, 0] ** 2)) < 0.5 * np.sqrt(np.mean(raw[:, 0] ** 2))


def test_correlations_are_kept_by_how_many_chance_would_leave():
    """Of 4,950 pairs of independent coordinates some 230 lie beyond two standard errors."""
    rng = np.random.default_rng(6)
    sample = rng.standard_normal((400, 100))
    factor = Transport.fit(sample).factor
    assert np.abs(np.tril(factor, -1)).max() < 0.1
    tied = sample + 0.7 * rng.standard_normal((400, 1))
    factor = Transport.fit(tied).factor
    covariance = factor @ factor.T
    sd = np.sqrt(np.diag(covariance))
    kept = (covariance / np.outer(sd, sd))[np.triu_indices(100, 1)]
    # Correlation 0.49/1.49, less what the shrinking by its own error takes.
    assert abs(kept.mean() - 0.49 / 1.49) < 0.06


def test_spline_goes_through_the_quantiles_and_never_falls():
    sample = stats.gumbel_r().rvs((40_000, 1), random_state=np.random.default_rng(3))
    spline = Transport.fit(np.hstack([sample, sample[::-1]])).spline
    knots = np.linspace(-3, 3, 13)
    found = spline(np.tile(knots, (2, 1)))[0][0]
    np.testing.assert_allclose(found, np.quantile(sample, special.ndtr(knots)), rtol=1e-12)
    grid = np.tile(np.linspace(-6, 6, 2001), (2, 1))
    assert np.all(np.diff(spline(grid)[0][0]) > 0)


def test_ties_do_not_flatten_the_map():
    sample = np.random.default_rng(4).standard_normal((3000, 2))
    sample[:1500, 0] = 0.25
    x, log_jacobian = Transport.fit(sample)(np.random.default_rng(5).standard_normal((500, 2)))
    assert np.all(np.isfinite(log_jacobian))
    assert len(np.unique(x[:, 0])) == 500


def test_points_map_alike_alone_and_together(fitted):
    z = np.random.default_rng(6).standard_normal((40, 5))
    whole = fitted(z)
    for part in (slice(0, 1), slice(3, 20)):
        np.testing.assert_allclose(fitted(z[part])[0], whole[0][part], rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(fitted(z[part])[1], whole[1][part], rtol=1e-13, atol=1e-13)


def test_weights_stand_for_repeated_points():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(300, 3))
    times = rng.integers(1, 4, size=300)
    weighted = Affine.fit(points, times / times.sum())
    repeated = np.repeat(points, times, axis=0)
    again = Affine.fit(repeated, np.full(len(repeated), 1 / len(repeated)))
    for field in dataclasses.fields(Affine):
        np.testing.assert_allclose(
            getattr(weighted, field.name), getattr(again, field.name), rtol=1e-10, atol=1e-13
        )


def test_transported_density_is_the_targets_times_the_jacobian():
    centre, mix = np.array([1.0, -2.0]), np.array([[2.0, 0.0], [0.5, 3.0]])
    here = Transported(Normal(2), Affine.normal(centre, mix @ mix.T))
    z = np.random.default_rng(0).standard_normal((10, 2))
    wanted = -0.5 * ((centre + z @ mix.T) ** 2).sum(axis=1) + np.log(6.0)
    np.testing.assert_allclose(here(z), wanted, rtol=1e-8)


@pytest.mark.parametrize("dimension", [5, 22, 40])
def test_no_point_depends_on_how_many_are_mapped_with_it(dimension):
    rng = np.random.default_rng(dimension)
    x = rng.normal(size=(3000, dimension)) @ rng.normal(size=(dimension, dimension))
    x[:, 1] *= np.exp(0.05 * x[:, 0])
    transport = Transport.fit(x)
    z = rng.normal(size=(1100, dimension))
    points, log_jacobians = transport(z)
    for size in (1, 37, 138, 1025):
        parts = [transport(z[start : start + size]) for start in range(0, len(z), size)]
        np.testing.assert_array_equal(np.concatenate([part for part, _ in parts]), points)
        np.testing.assert_array_equal(np.concatenate([part for _, part in parts]), log_jacobians)


def test_the_order_in_memory_does_not_choose_drivers():
    """What widens another and is widened by it alike is told apart from it by rounding alone."""
    for seed in range(24):
        rng = np.random.default_rng(seed)
        size = 2 + seed % 8
        x = rng.normal(size=(12_000, size))
        for i in range(0, size - 1, 2):
            x[:, i + 1] *= np.exp(0.35 * x[:, i])
        x = x @ (np.eye(size) + 0.4 * np.tril(rng.normal(size=(size, size)), -1)).T
        by_rows, by_columns = Transport.fit(x), Transport.fit(np.asfortranarray(x))
        assert len(by_rows.drivers) > 0
        np.testing.assert_array_equal(by_rows.drivers, by_columns.drivers)
