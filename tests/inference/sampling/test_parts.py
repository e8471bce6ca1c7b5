"""A long run in parts: estimates lose nothing, little is kept, and slow parts are not closed."""

import numpy as np
import pytest
from scipy import stats

from percept.inference.sampling import run as module
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import FEWEST_POSITIONS, sample
from tests import LONG
from tests.inference.sampling.targets import Means, Normal, SkewedHeavy


@pytest.fixture(autouse=True)
def _short_parts(monkeypatch):
    monkeypatch.setattr(module, "_MOST_DRAWS", 1)


class Remembered(Means):
    """Means of two functions, and all values they were ever given."""

    def __init__(self):
        super().__init__(("a", "b"), lambda points: np.tanh(points[:, :2]))
        self.values = []

    def components(self, points):
        found = super().components(points)
        self.values.append(found)
        return found


def test_means_are_those_of_all_draws():
    means = Remembered()
    run = sample(SkewedHeavy(3), means, Settings(tolerance=0.0025, seed=3))
    assert run.gate.passed, run.gate.reasons
    kept = run.points[..., 0].size
    assert run.points.shape[1] <= FEWEST_POSITIONS
    # A chain begins with a call of one draw. The last chain's draws count.
    begun = max(call for call, values in enumerate(means.values) if len(values) == 1)
    drawn = np.concatenate(means.values[begun + 1 :])
    assert len(drawn) > 3 * kept
    # Sums of half a million numbers in two orders.
    np.testing.assert_allclose(run.estimates.value, drawn.mean(axis=0), rtol=0, atol=1e-13)


@pytest.mark.evidence(reduced=True)
def test_claimed_errors_of_parts_together_are_right():
    """Of a normal's mean, zero: scatter of runs over what they claim."""
    count = 40 if LONG else 2
    means = Means(("E x",), lambda points: points[:, :1])
    runs = [
        sample(Normal(2), means, Settings(tolerance=0.004, seed=seed))
        for seed in range(1, count + 1)
    ]
    assert all(run.gate.passed for run in runs)
    # Refined runs keep one position in six steps, first rounds one in three.
    assert all(run.stride > 3 for run in runs)
    z = np.array([run.estimates.value[0] / run.estimates.errors[0] for run in runs])
    # Sum of squares of standard normals: beyond these with probability 0.001 each.
    assert stats.chi2.ppf(0.001, count) < z @ z < stats.chi2.isf(0.001, count)
