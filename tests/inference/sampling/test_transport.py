"""The transport: an exact Jacobian, a monotone spline, and a target that comes out nearly
normal."""

import numpy as np
import pytest
from scipy import special, stats

from percept.inference.sampling.moves import ReferenceLaw, Transported
from percept.inference.sampling.transport import Transport
from percept.inference.sampling.warmup import Affine
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
    law = ReferenceLaw(len(transported.target.names))
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


def test_target_comes_out_nearly_normal():
    """On average over samples: how far one sample reaches into the funnel is chance."""
    target = Funnel()
    samples = [target.exact(8000, np.random.default_rng(seed)) for seed in range(1, 7)]
    affine = Affine.fit(samples[0], np.full(len(samples[0]), 1 / len(samples[0])))
    fitted = [efficiency(Transported(target, Transport.fit(sample))) for sample in samples]
    assert np.mean(fitted) > 0.5
    assert efficiency(Transported(target, affine)) < 0.3
