"""The transport: an exact Jacobian, a monotone spline, and a target that comes out nearly
normal."""

import dataclasses

import numpy as np
import pytest
from scipy import special, stats

from percept.inference.sampling.moves import ReferenceLaw
from percept.inference.sampling.target import Affine, Transported
from percept.inference.sampling.transport import Transport
from tests.inference.sampling.targets import Normal


class Skewed(Normal):
    """A correlated pair, the first of which is bent; x_2 is exponential, and x_3 independent."""

    def __init__(self):
        super().__init__(4)

    def exact(self, count, rng):
        x = rng.standard_normal((count, 4))
        x[:, 1] = 0.9 * x[:, 0] + np.sqrt(0.19) * x[:, 1]
        x[:, 0] = np.sinh(x[:, 0])
        x[:, 2] = -np.log(special.ndtr(-x[:, 2]))
        return x

    def __call__(self, points):
        first = np.arcsinh(points[:, 0])
        value = stats.norm.logpdf(first) - 0.5 * np.log1p(points[:, 0] ** 2)
        value += stats.norm.logpdf(points[:, 1], 0.9 * first, np.sqrt(0.19))
        value += stats.norm.logpdf(points[:, 3])
        return value + np.where(points[:, 2] > 0, -points[:, 2], -np.inf)


def efficiency(transported, count=20_000):
    """Effective share of importance draws."""
    law = ReferenceLaw(len(transported.names))
    z = law.draw(count, np.random.default_rng(3))
    log_weights = transported(z) - law.log_density(z)
    weights = np.exp(log_weights - log_weights.max())
    return weights.sum() ** 2 / (weights @ weights) / count


@pytest.fixture(scope="module")
def fitted():
    return Transport.fit(Skewed().exact(8000, np.random.default_rng(1)))


def test_jacobian_is_the_maps_own(fitted):
    z = 1.3 * np.random.default_rng(2).standard_normal((60, 4))
    _, found = fitted(z)
    step = 1e-5
    columns = [
        (fitted(z + step * unit)[0] - fitted(z - step * unit)[0]) / (2 * step) for unit in np.eye(4)
    ]
    wanted = np.linalg.slogdet(np.stack(columns, axis=2))[1]
    # A difference across a knot of the spline says less.
    close = np.abs(found - wanted) < 1e-6 * (1 + np.abs(wanted))
    assert close.mean() > 0.95


def test_target_comes_out_nearly_normal(fitted):
    target = Skewed()
    sample = target.exact(8000, np.random.default_rng(1))
    affine = Affine.fit(sample, np.full(len(sample), 1 / len(sample)))
    assert efficiency(Transported(target, fitted)) > 0.8
    assert efficiency(Transported(target, affine)) < 0.4


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
