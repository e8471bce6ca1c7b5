"""The gate withholds what must be withheld and says why; broken densities are refused by name."""

import numpy as np
import pytest
from scipy import signal

from percept.errors import RefusalError
from percept.inference.sampling.diagnostics import split_rhat
from percept.inference.sampling.gate import (
    Measured,
    Settings,
    measure,
    pass_gate,
)
from percept.inference.sampling.run import sample
from tests.inference.sampling.targets import Means, Normal


def first(points):
    return points[:, :1]


MEAN = Means(("E x[0]",), first)


class Glitch(Normal):
    """A normal whose density is wrong, by a factor exp(40), at one point in five thousand."""

    def __call__(self, points):
        lottery = np.modf(np.abs(points[:, 0]) * 1e4)[0]
        return super().__call__(points) + np.where(lottery < 2e-4, 40.0, 0.0)


class Hole(Normal):
    """NaN or -inf on a part of the space."""

    def __init__(self, dimension, value, beyond):
        super().__init__(dimension)
        self._value, self._beyond = value, beyond

    def __call__(self, points):
        return np.where(points[:, 0] > self._beyond, self._value, super().__call__(points))


def test_passes_on_a_plain_target():
    run = sample(Normal(5), MEAN, Settings(tolerance=0.02, seed=1))
    assert run.gate.passed
    assert run.gate.reasons == ()
    assert run.gate.rhat < 1.01
    assert run.gate.times_run >= 10
    assert run.gate.worst_error <= 0.02
    assert run.gate.tolerance_met
    assert run.gate.error_reached == ""
    assert run.gate.worst == "E x[0]"
    assert abs(run.estimates.value[0]) < 4 * run.estimates.errors[0]


def test_stuck_walkers_are_withheld():
    run = sample(Glitch(3), MEAN, Settings(tolerance=0.01, seed=3, most_steps=600))
    assert not run.gate.passed
    assert any(
        "did not move in the second half of the run" in reason for reason in run.gate.reasons
    )


def verdict(*, error=0.02, time=1.0, rhat=1.0, acceptance=0.5, moved=True, length=60):
    """The gate of one quantity that is as it should be but for what is given; 32 walkers."""
    numbers = np.array([[0.0], [1.0], [error], [time], [rhat]])
    points = np.zeros((4, length, 8, 1)) + moved * np.arange(length)[:, None, None]
    accepted = np.full(32, 0.5)
    accepted[13] = acceptance
    measured = Measured(("E x",), *numbers)
    return pass_gate(Settings(tolerance=0.5), measured, points, accepted, stride=1, spanned=length)


def test_rank_rhat_of_one_hundredth_above_one_is_too_much():
    assert verdict(rhat=1.0099).passed
    for rhat in (1.01, 1.0199, np.nan):
        gate = verdict(rhat=rhat)
        assert gate.reasons == (
            f"the ensembles disagree on E x: rank R-hat {rhat:.4f}, limit 1.01.",
        )


def test_ten_autocorrelation_times_are_needed():
    assert verdict(length=60, time=6.0).passed
    for time in (6.01, 11.9):  # five times would be enough for both
        (reason,) = verdict(length=60, time=time).reasons
        assert reason.startswith(
            f"the run spans {60 / time:.1f} autocorrelation times of its slowest quantity, E x;"
            " 10 are needed."
        )
    assert not verdict(time=np.inf).passed


def test_one_walker_that_does_not_move_is_too_much():
    moved = np.ones((4, 1, 8, 1))
    moved[1, :, 5] = 0.0
    assert verdict(moved=moved).reasons == ("1 walker did not move in the second half of the run.",)


def test_a_walker_that_hardly_accepts_is_withheld():
    """It moved now and then, but far too seldom to have seen its surroundings."""
    stuck = verdict(acceptance=0.004)
    assert stuck.reasons == ("a walker is stuck: it accepted 0.40% of its proposals.",)
    assert verdict(acceptance=0.006).passed


def test_a_run_that_mixes_ends_at_its_cap_with_the_error_it_reached():
    run = sample(Normal(4), MEAN, Settings(tolerance=1e-5, seed=1, most_steps=300))
    assert run.steps <= 400
    assert run.gate.passed
    assert run.gate.reasons == ()
    assert run.gate.rhat < 1.01
    assert not run.gate.tolerance_met
    assert (
        run.gate.error_reached
        == f"The Monte Carlo error reached is {100 * run.gate.worst_error:.3g} % of a half-width (E"
        " x[0]), and 0.001 % was requested. A larger most_steps (now 300) lowers it."
    )
    assert abs(run.estimates.value[0]) < 4 * run.estimates.errors[0]


@pytest.mark.parametrize("beyond", [-np.inf, 0.5, 2.0])
def test_nan_is_refused_by_name(beyond):
    with pytest.raises(RefusalError, match=r"the log density is NaN at .*x\[0\] = "):
        sample(Hole(3, np.nan, beyond), MEAN, Settings(seed=1))


def test_impossible_everywhere_is_refused_by_name():
    with pytest.raises(RefusalError, match=r"-inf at 2048 of 2048 .*x\[0\] = .*Check"):
        sample(Hole(3, -np.inf, -np.inf), MEAN, Settings(seed=1))


def test_a_truncated_target_is_sampled():
    """-inf on a part is legal: a half of the normal, whose mean is sqrt(2/pi) below zero."""
    run = sample(Hole(2, -np.inf, 0.0), MEAN, Settings(tolerance=0.02, seed=4))
    assert run.gate.passed, run.gate.reasons
    assert abs(run.estimates.value[0] + np.sqrt(2 / np.pi)) < 4 * run.estimates.errors[0]


def test_same_seed_same_digits_other_seed_same_answer():
    runs = [sample(Normal(4), MEAN, Settings(tolerance=0.02, seed=seed)) for seed in (7, 7, 8)]
    np.testing.assert_array_equal(runs[0].points, runs[1].points)
    np.testing.assert_array_equal(runs[0].estimates.value, runs[1].estimates.value)
    assert runs[0].gate == runs[1].gate
    assert not np.array_equal(runs[0].points[:, :5], runs[2].points[:, :5])
    error = np.hypot(runs[0].estimates.errors, runs[2].estimates.errors)
    assert np.all(np.abs(runs[0].estimates.value - runs[2].estimates.value) < 4 * error)


def judged(components):
    """The gate of a run whose components are given, of shape (E, T, W, Q), one position in three
    steps."""
    names = tuple(f"E x[{i}]" for i in range(components.shape[-1]))
    found = measure(Means(names, first), components)
    ensembles, length, walkers, _ = components.shape
    points = np.tile(np.arange(length)[:, None, None], (ensembles, 1, walkers, 1))
    accepted = np.full(ensembles * walkers, 0.5)
    return pass_gate(Settings(tolerance=0.9), found, points, accepted, 3, 3 * length)


def test_rare_spikes_do_not_hide_what_is_slow():
    """They have all the variance and no memory; ranks see what lies below them."""
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((4, 300, 64, 1))
    noise[:, 1:] *= np.sqrt(1 - 0.98**2)
    slow = signal.lfilter([1.0], [1.0, -0.98], noise, axis=1)
    spikes = 1e3 * (rng.random(slow.shape) < 0.01) * rng.standard_normal(slow.shape)
    # Steps: three times (1 + 0.98)/(1 - 0.98) = 99 positions, of which 300 positions show the most
    # part.
    assert judged(slow).autocorrelation_time > 100
    assert judged(slow + spikes).autocorrelation_time > 50


def two_modes(rng, left):
    """Values (4, 200, 64, 1) of walkers that stay near -1 or 1, with the modes they are in; SD
    0.5."""
    return np.where(left, -1.0, 1.0) + 0.5 * rng.normal(size=(4, 200, 64, 1))


def test_ensembles_stuck_in_different_modes_are_withheld():
    """One of four ensembles lies in another mode; the same values in any order pass."""
    rng = np.random.default_rng(2)
    stuck = two_modes(rng, (np.arange(4) == 2)[:, None, None, None])
    found = judged(stuck)
    assert "the ensembles disagree on E x[0]: rank R-hat" in found.reasons[-1]
    shuffled = rng.permutation(stuck.ravel()).reshape(stuck.shape)
    assert judged(shuffled).passed


def test_walkers_stuck_in_a_tail_are_withheld():
    """Walkers that stay beyond the 98th percentile, in spikes' shadow, among others that never
    go there."""
    rng = np.random.default_rng(4)
    values = np.clip(rng.normal(size=(4, 200, 64, 1)), -2.0, 2.0)
    assert judged(values).passed
    values[:, :, :1] = 2.5 + 0.1 * rng.random((4, 200, 1, 1))
    assert not judged(values).passed


def test_an_ensemble_that_never_reaches_the_tails_is_withheld():
    """Ranks hardly tell: a tenth of the draws of one in four ensembles lies a little too near."""
    values = np.random.default_rng(5).normal(size=(4, 200, 64, 1))
    assert judged(values).passed
    values[2] = np.clip(values[2], -1.5, 1.5)
    assert split_rhat(values.reshape(4, -1, 1), "rank")[0] < 1.005
    (reason,) = judged(values).reasons
    assert reason.startswith("the ensembles disagree on E x[0]: rank R-hat 1.02")
