"""Ensembles divided among processes draw what they draw together, bit for bit."""

import dataclasses

import numpy as np
import pytest

from percept.errors import RefusalError
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.estimands import IntervalEstimands
from percept.inference.hierarchy.pooled import Pooled
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.statistics import from_trials
from percept.inference.sampling.checked import Checked
from percept.inference.sampling.ensembles import start
from percept.inference.sampling.estimands import Means
from percept.inference.sampling.pieces import run_piece
from percept.inference.sampling.run import Settings, sample
from percept.inference.sampling.transported import Affine, Transported
from percept.inference.share import ALONE
from percept.processes import Processes
from tests.inference.sampling.targets import Normal, SkewedHeavy


def first(points):
    return points[:, :1]


def squashed(points):
    return np.tanh(points[:, :2])


class Backwards:
    """Divides work into parts and does the last first."""

    def __init__(self, parts):
        self.parts = parts
        self.calls = 0

    def __call__(self, function, arguments):
        self.calls += len(arguments)
        return [function(*each) for each in reversed(arguments)][::-1]


def fields(record):
    return {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}


@pytest.mark.parametrize("parts", [2, 3, 4, 7])
def test_divided_in_any_way_it_is_the_same_piece(parts):
    target = SkewedHeavy(3)
    here = Transported(target, Affine(np.zeros(3), np.eye(3)))
    begun = start(here, np.random.default_rng(1).normal(size=(4, 64, 3)), np.random.SeedSequence(2))
    asked = {"steps": 30, "stride": 3, "walkers": 48}
    whole = run_piece(here, Means(("a",), first), begun, **asked, share=ALONE)
    share = Backwards(parts)
    divided = run_piece(here, Means(("a",), first), begun, **asked, share=share)
    assert share.calls == min(parts, 4)
    assert whole.points.shape == (4, 10, 48, 3)
    np.testing.assert_array_equal(divided.points, whole.points)
    np.testing.assert_array_equal(divided.components, whole.components)
    for name, value in fields(whole.state).items():
        np.testing.assert_equal(getattr(divided.state, name), value)


@pytest.mark.parametrize("parts", [2, 3, 4])
def test_divided_in_any_way_it_is_the_same_run(parts):
    """Refined, and of means, whose last bits depend on the order of draws in memory."""
    means = Means(("a", "b"), squashed)
    settings = Settings(tolerance=0.004, seed=3)
    alone, divided = (sample(SkewedHeavy(3), means, settings, share=s) for s in (ALONE, Backwards(parts)))
    assert alone.points.shape[2] > 64
    for name in ("points", "components", "errors", "times"):
        np.testing.assert_array_equal(getattr(divided, name), getattr(alone, name))
    np.testing.assert_array_equal(divided.estimates.value, alone.estimates.value)
    assert divided.gate == alone.gate


def hierarchical():
    rng = np.random.default_rng(4)
    subject, environment = (index.ravel() for index in np.indices((6, 2)))
    responses = 0.2 * rng.normal(size=(12, 2)) + 0.1 * rng.normal(size=(6, 1))[subject]
    statistics = from_trials(
        responses, subject, environment, np.array([[0.0, 1.0], [0.0, 1.0]]),
        parameters=("k", "b"), environments=("VE1", "VE2"), subjects=tuple("ABCDEF"),
    )  # fmt: skip
    return Pooled(CollapsedDensity(statistics, Priors()))


def test_two_processes_give_the_run_of_one():
    model = hierarchical()
    estimands, settings = IntervalEstimands(model), Settings(tolerance=0.02, seed=5)
    alone = sample(model, estimands, settings)
    with Processes(2, preload=["percept.inference.sampling.pieces"]) as processes:
        # The first calls may find the other process still at its imports, and are then made here.
        processes.ask(abs, -1)()
        together = sample(model, estimands, settings, share=processes)
        assert processes.answered > 2
    for name in ("points", "components", "errors", "times"):
        np.testing.assert_array_equal(getattr(together, name), getattr(alone, name))
    np.testing.assert_array_equal(together.estimates.value, alone.estimates.value)
    assert together.gate == alone.gate


class Broken(Normal):
    """NaN in the tails."""

    def __call__(self, points):
        return np.where(np.abs(points[:, 0]) > 3.0, np.nan, super().__call__(points))


def test_a_refusal_elsewhere_is_a_refusal_here():
    here = Transported(Checked(Broken(2)), Affine(np.zeros(2), np.eye(2)))
    begun = start(here, np.random.default_rng(1).uniform(-1, 1, size=(4, 64, 2)), np.random.SeedSequence(2))
    with (
        Processes(2) as processes,
        pytest.raises(RefusalError, match=r"the log density is NaN at x\[0\] = -?[3-9]\."),
    ):
        run_piece(here, Means(("E x",), first), begun, steps=120, stride=3, walkers=64, share=processes)
