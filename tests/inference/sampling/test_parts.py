"""A long run in parts: estimates lose nothing, little is kept, and slow parts are not closed."""

import dataclasses
import math

import numpy as np
import pytest
from scipy import stats

from percept.inference.sampling import chain as chains
from percept.inference.sampling.chain import Chain, Memory, Pace, Task
from percept.inference.sampling.coordinates import Affine, Transported
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.moves import Ensembles
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


class Walk(Ensembles):
    """Autoregressive chains in place of the walkers: a step remembers all but a fiftieth of the
    last."""

    def __init__(self, target, points, seed):
        super().__init__(target, points, seed)
        self.rng, self.here = np.random.default_rng(seed), points

    def advance(self, steps, stride, *, learn=False):
        kept = []
        for step in range(1, steps + 1):
            self.here = 0.98 * self.here + np.sqrt(1 - 0.98**2) * self.rng.standard_normal(
                self.here.shape
            )
            if step % stride == 0:
                kept.append(self.here)
        self.accepted, self.steps = self.accepted + steps, self.steps + steps
        return np.stack(kept, axis=1)


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


def test_a_part_that_has_not_settled_goes_on_thinned(monkeypatch):
    """Chains that remember a hundred steps need longer parts than there is room for at every
    third step."""
    monkeypatch.setattr(chains, "Ensembles", Walk)
    means = Means(("E x",), lambda points: points[:, :1])
    run = sample(Normal(1), means, Settings(tolerance=0.008, seed=1), memory=Memory(draws=1 << 14))
    assert run.gate.passed, run.gate.reasons
    assert run.gate.autocorrelation_time == pytest.approx(99.0, rel=0.2)
    assert run.stride > 3
    assert run.gate.times_run >= 10
    assert run.steps > 10 * 99


def test_no_last_part_begins_that_could_not_settle(monkeypatch):
    """A part takes 1,000 steps to settle here; the first has 3,072, and the cap leaves 700 for
    another."""
    monkeypatch.setattr(chains, "Ensembles", Walk)
    means = Means(("E x",), lambda points: points[:, :1])
    settings = Settings(tolerance=1e-5, seed=1, most_steps=3800)
    run = sample(Normal(1), means, settings, memory=Memory(draws=1 << 20))
    assert run.gate.passed, run.gate.reasons
    assert run.gate.times_run >= 10
    assert not run.gate.tolerance_met


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("most", range(420, 540, 17 if LONG else 51))
def test_wherever_the_steps_end_the_errors_are_known(most):
    """The last part of a run at its cap is long enough to be judged, however many steps were
    left for it."""
    run = sample(
        Normal(2),
        Means(("E x",), lambda points: points[:, :1]),
        Settings(tolerance=1e-5, most_steps=most),
        memory=SMALL,
    )
    assert run.gate.passed
    assert not run.gate.tolerance_met
    assert run.steps <= most + 6
    # A thousand walkers of independent draws a step, or nearly so, at every third step.
    assert 0.5 < run.errors[0] * np.sqrt(1024 * run.steps / 3) < 3.0


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


def test_parts_weigh_by_their_steps():
    part = chain(np.random.default_rng(6).normal(size=(4, 40, 64, 1)))
    alone = part.judge()
    part._closed = closed(alone, 1.0, 0.3, 360)
    together = part.judge()
    assert together.estimates.value == pytest.approx(0.75 * 1.0 + 0.25 * alone.estimates.value)
    assert together.errors == pytest.approx(np.hypot(0.75 * 0.3, 0.25 * alone.errors))


def test_time_left_follows_the_steps_expected(monkeypatch):
    """Half a second a step at 120 steps; the errors ask for 1.1 (error/tolerance)² times as
    many."""
    told = []
    values = np.random.default_rng(7).normal(size=(4, 40, 64, 1))
    monkeypatch.setattr(chains.time, "monotonic", lambda: 0.0)
    part = chain(values, progress=told.append)
    monkeypatch.setattr(chains.time, "monotonic", lambda: 60.0)
    run = part.judge()
    expected = 1.1 * 120 * (run.gate.worst_error / 0.005) ** 2
    assert told[0].expected_steps == math.ceil(expected)
    assert told[0].seconds_left == pytest.approx(0.5 * (expected - 120))
