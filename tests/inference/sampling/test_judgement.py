"""Estimands judged in parts, against the diagnostics worked out at once."""

import numpy as np

from percept.inference.sampling.diagnostics import (
    normal_scores,
    split_rhat,
)
from percept.inference.sampling.gate import measure
from tests.inference.sampling.targets import Means


class Apart(Means):
    """Means of two components, each a part of its own."""

    def __init__(self):
        super().__init__((), lambda points: points)

    def estimates(self, components):
        for column in (0, 1):
            yield from Means((f"E {column}",), lambda points: points).estimates(
                components[:, [column]]
            )


def chains(rho=0.6, apart=0.0):
    rng = np.random.default_rng(1)
    series = rng.normal(size=(4, 60, 64, 3))
    for t in range(1, 60):
        series[:, t] = rho * series[:, t - 1] + np.sqrt(1 - rho * rho) * series[:, t]
    series[..., 1] = series[..., 1] ** 2
    series[..., 2] = 4.0  # what never changes says nothing
    return series + apart * np.array([1, -1, 1, -1])[:, None, None, None]


def test_rhat_is_that_of_ranks_and_tails():
    components = chains(rho=0.0)
    found = measure(Apart(), components)
    scores = normal_scores(components[..., :2].reshape(4, -1, 2))
    tails = np.where(np.abs(scores) > 1.645, 1.0, 0.0)
    wanted = np.maximum(split_rhat(scores, "rank"), split_rhat(tails, "split"))
    np.testing.assert_allclose(found.rhats, wanted, atol=1e-6)
    assert found.rhats.max() < 1.01
    assert measure(Apart(), chains(apart=0.3)).rhats.min() > 1.01
