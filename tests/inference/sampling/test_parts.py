"""A long run in parts: estimates lose nothing, little is kept, and slow parts are not closed."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from percept.inference.sampling import chain as chains
from percept.inference.sampling.chain import Chain, Memory, Pace, Task
from percept.inference.sampling.coordinates import Affine, Transported
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from tests import LONG
from tests.inference.sampling.targets import Means, Normal, SkewedHeavy


class Remembered(Means):
    """Means of two functions, and all values they were ever given."""

    def __init__(self):
        super().__init__(("a", "b"), lambda points: np.tanh(points[:, :2]))
        self.values = []

    def components(self, points):
        found = super().components(points)
        self.values.append(found)
        return found


#: Parts of as few positions as there may be.
SMALL = Memory(draws=1)


def test_means_are_those_of_all_draws():
    means = Remembered()
    run = sample(SkewedHeavy(3), means, Settings(tolerance=0.0015, seed=3), memory=SMALL)
    assert run.gate.passed, run.gate.reasons
    kept = run.points[..., 0].size
    assert run.points.shape[1] <= SMALL.fewest_positions
    # The run began anew after its first round, of which one call of one draw tells.
    begun = [len(values) for values in means.values].index(1, 1)
    drawn = np.concatenate(means.values[begun + 1 :])
    assert len(drawn) > 3 * kept
    # Sums of half a million numbers in two orders.
    np.testing.assert_allclose(run.estimates.value, drawn.mean(axis=0), rtol=0, atol=1e-13)


@pytest.mark.evidence(reduced=True)
def test_claimed_errors_of_parts_together_are_right():
    """Of a normal's mean, zero: scatter of runs over what they claim."""
    count = 40 if LONG else 3
    means = Means(("E x",), lambda points: points[:, :1])
    runs = [
        sample(Normal(2), means, Settings(tolerance=0.004, seed=seed), memory=SMALL)
        for seed in range(1, count + 1)
    ]
    assert all(run.gate.passed for run in runs)
    # Refined runs keep one position in six steps, first rounds one in three.
    assert all(run.stride > 3 for run in runs)
    z = np.array([run.estimates.value[0] / run.errors[0] for run in runs])
    # Sum of squares of standard normals: beyond these with probability 0.001 each.
    assert stats.chi2.ppf(0.001, count) < z @ z < stats.chi2.isf(0.001, count)


MEAN = Means(("E x",), lambda points: points)


def chain(components, *, steps=120, accepted=60, progress=None):
    """A chain at rest that has kept positions at every third step, its components (E, T, W, Q)
    given."""
    ensembles, _, walkers, _ = components.shape
    here = Transported(Normal(1), Affine(np.zeros(1), np.eye(1)))
    points = np.random.default_rng(9).normal(size=(*components.shape[:3], 1))
    task = Task(MEAN, Settings(tolerance=0.005), progress=progress)
    made = Chain(task, here, points[:, -1], np.random.SeedSequence(1), Pace(3, 120))
    made._walkers.steps, made._walkers.accepted = steps, np.full(ensembles * walkers, accepted)
    made._points, made._components = [points], [components]
    return made


def closed(run, value, error, steps):
    """A run in place of closed parts, with other estimates."""
    estimates = dataclasses.replace(run.estimates, value=np.array([value]))
    replaced = dataclasses.replace(run, estimates=estimates, errors=np.array([error]))
    return chains._Closed(replaced, steps)


def test_a_last_part_whose_ensembles_disagree_is_withheld_though_all_parts_are_accurate():
    rng = np.random.default_rng(5)
    apart = 0.3 * np.array([1.0, -1.0, 1.0, -1.0])[:, None, None, None]
    late = chain(rng.normal(size=(4, 40, 64, 1)) + apart, steps=10_120, accepted=5_000)
    late._closed = closed(late.judge(), 0.0, 1e-3, 10_000)
    gate = late.judge().gate
    assert gate.worst_error < 0.005
    assert "the ensembles disagree on E x: rank R-hat" in " ".join(gate.reasons)
