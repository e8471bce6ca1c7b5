"""What a run estimates, how far that can be believed, and the gate that withholds what cannot.

An estimate's influence function is the pull of each draw on it, so that the estimate's Monte Carlo
error is the standard error of a mean of correlated numbers. No walker sees another, so the scatter
of the means of walkers tells it. How long a run must be follows from the autocorrelation time of
the influence functions. `measure` finds errors, times and R-hat from the draws of all walkers.
`pass_gate` compares them with the limits below. A run that fails it gives no numbers. A run that
passes and misses the tolerance gives its numbers and says the error it reached.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.diagnostics import (
    autocorrelation_time,
    monte_carlo_error,
    normal_scores,
    split_rhat,
)

Array = NDArray[np.float64]

#: Autocorrelation times a run must span. With 4 ensembles of 64 walkers the estimated time of an
#: autoregressive series is then 5 % too low, give or take 5 %.
_TIMES_NEEDED = 10.0
#: Runs aim at this multiple of that: the estimated time grows with the run, by more than 5 % if
#: the series has slower parts.
_TIMES_MARGIN = 1.2
#: The same multiple in advice after a run that was too short, and found the time far too low.
_ADVISED_MARGIN = 1.5
#: Least growth of `most_steps` that is advised: with less the next run might just fail again.
_LEAST_GROWTH = 2.0
#: Fewest positions of a walker that R-hat compares: two in each half, for a variance.
_FEWEST_COMPARED = 4
#: Rank R-hat that every quantity must stay below (Vehtari et al. 2021).
_RHAT_LIMIT = 1.01
#: Accepted share of proposals below which a walker counts as stuck: walkers that mix accept half of
#: them, the slowest a seventh.
_STUCK = 0.005
#: Batches of walkers in an ensemble: 32 in 4 ensembles, whose scatter is an SD to an eighth.
_BATCHES = 8
#: Values whose ranks are compared: chance alone then leaves R-hat within 0.001 of one.
_RANKED = 1 << 14
#: Walkers per ensemble that are kept, even if their values are more than that.
_FEWEST_KEPT = 8
#: Normal score beyond which a draw lies in a tail: a twentieth of the draws at either end.
_TAIL = 1.645


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of Q quantities."""

    names: tuple[str, ...]  # One name per estimate
    value: Array  # (Q,) Estimates
    scale: Array  # (Q,) What a tolerance of one means, such as an interval's half-width


@dataclass(frozen=True, eq=False)
class Measured(Estimates):
    """Estimates of Q quantities, and how far they can be believed."""

    errors: Array  # (Q,) Monte Carlo standard errors
    times: Array  # (Q,) Autocorrelation times of the influence functions' ranks, in positions
    rhats: Array  # (Q,) Rank R-hat of the influence functions across ensembles


class Estimands(Protocol):
    """Reported quantities of a target."""

    def components(self, points: Array) -> Array:
        """Quantities kept per draw: points (W, d) to an array (W, C)."""

    def estimates(self, components: Array) -> Iterable[tuple[Estimates, Array]]:
        """Estimates from components (S, C) of S draws, and their influence functions, in groups.

        An influence function (S, Q) is the first-order pull of each draw on each estimate. Its mean
        over draws is zero, and its standard error is the estimate's. Memory holds one group at
        a time.
        """


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How to sample."""

    tolerance: float = 0.01  # Monte Carlo error of each limit over the interval's half-width
    seed: int = 1  # Seed of the whole run
    #: Steps per ensemble since the last restart, after which the run ends, whatever its error. It
    #: always takes its burn-in and one round, and it completes its last stride.
    most_steps: int = 20_000


@dataclass(frozen=True)
class Gate:
    """Verdict on a run."""

    passed: bool  # Whether the run has mixed, so that its numbers may be reported with their errors
    reasons: tuple[str, ...]  # What failed
    rhat: float  # Largest rank R-hat across ensembles
    autocorrelation_time: float  # Longest autocorrelation time of a reported quantity, in steps
    slowest: str  # The quantity it belongs to
    times_run: float  # Kept steps over that time; of a run in parts, of its last part
    effective_draws: float  # Effective draws of the slowest reported quantity
    acceptance: float  # Mean acceptance fraction
    lowest_acceptance: float  # Of the slowest walker
    worst_error: float  # Largest Monte Carlo error over half-width
    worst: str  # The estimate it belongs to
    tolerance_met: bool  # Whether that error is within the tolerance
    error_reached: str  # A sentence on the error where it misses the tolerance, else empty
    rhat_limit: float = _RHAT_LIMIT  # What R-hat had to stay below
    times_needed: float = _TIMES_NEEDED  # What `times_run` had to reach


@dataclass(frozen=True)
class Progress:
    """State of a run, told as it goes; steps count from its last restart."""

    steps: int  # Steps per ensemble so far
    expected_steps: int  # Steps per ensemble the run is expected to need
    worst_error: float  # NaN before the first round is judged
    tolerance: float
    seconds_left: float = math.nan  # For whoever watches; it decides nothing
    quicker: str = ""  # What would make the run shorter


@dataclass(frozen=True, eq=False)
class Run:
    """A finished run."""

    points: Array  # (E, T, W, d) Kept coordinates, one in `stride` steps
    components: Array  # (E, T, W, C) What the estimands keep per draw
    estimates: Measured  # What was asked for
    gate: Gate  # The verdict
    steps: int  # Per ensemble, burn-in included
    stride: int  # Steps between kept positions
    settings: Settings  # As given

    @property
    def steps_to_settle(self) -> int:
        """Predict the steps a part must span to pass; zero where the time is not known."""
        slowest = self.gate.autocorrelation_time
        if not math.isfinite(slowest):
            return 0
        return math.ceil(_TIMES_MARGIN * _TIMES_NEEDED * slowest)

    def _independent_positions(self) -> NDArray[np.intp]:
        """Kept positions about an autocorrelation time apart."""
        length = self.points.shape[1]
        gap = self.gate.autocorrelation_time / self.stride
        # Negated, so that a time that is not known leaves one position too.
        if not gap <= length:
            return np.array([length - 1])
        gap = max(1, round(gap))
        return np.arange(gap - 1, length, gap)

    def independent(self) -> Array:
        """Return kept positions thinned to the effective size, (S, d), ensemble after ensemble."""
        thinned = self.points[:, self._independent_positions()]
        return thinned.reshape(-1, thinned.shape[-1])

    def batches(self, *, every: bool = False) -> NDArray[np.intp]:
        """Return the batch of each of the `independent` positions, or of every one that is kept.

        They stand ensemble after ensemble, steps before walkers.

        A batch holds some walkers of an ensemble at all their steps: what a walker remembers stays
        in it.
        """
        ensembles, length, walkers, _ = self.points.shape
        positions = length if every else self._independent_positions().size
        batch = np.arange(walkers) * _BATCHES // walkers
        batches = np.tile(batch, positions)
        first = np.arange(ensembles)[:, None] * _BATCHES
        return (first + batches).ravel()


def measure(estimands: Estimands, components: Array) -> Measured:
    """Estimate from components (E, T, W, C), and measure errors and convergence."""
    flat = components.reshape(-1, components.shape[-1])
    names: list[str] = []
    groups = []
    for estimates, influence in estimands.estimates(flat):
        series = influence.reshape(*components.shape[:3], -1)
        names += estimates.names
        errors = monte_carlo_error(series)
        groups.append((estimates.value, estimates.scale, errors, *_mixing(series)))
    return Measured(tuple(names), *(np.concatenate(parts) for parts in zip(*groups, strict=True)))


def _mixing(series: Array) -> tuple[Array, Array]:
    """Measure autocorrelation times and R-hat (Q,) of the ranks of values (E, T, W, Q).

    Walkers are left out evenly where there are more than a time or a rank needs.
    """
    ensembles, length, walkers, count = series.shape
    kept = max(_FEWEST_KEPT, _RANKED // (ensembles * length))
    # Ranks, because with a heavy tail a few extreme draws would dominate the time and hide slower
    # parts.
    scores = normal_scores(series[:, :, :: math.ceil(walkers / kept)])
    tail = (np.abs(scores) > _TAIL).astype(float)
    times = np.maximum(autocorrelation_time(scores), autocorrelation_time(tail))
    # R-hat at about every independent position, but at no fewer than can be compared. The time of
    # values that never move is NaN, which fmin passes over.
    longest = np.fmin(times.max(), length / _FEWEST_COMPARED)
    gap = max(1, round(float(longest)))
    ranked = scores[:, ::gap].reshape(ensembles, -1, count)
    tails = tail[:, ::gap].reshape(ensembles, -1, count)
    return times, np.maximum(split_rhat(ranked, "rank"), split_rhat(tails, "split"))


def pass_gate(
    settings: Settings,
    measured: Measured,
    points: Array,
    acceptance: Array,
    stride: int,
    spanned: int,
) -> Gate:
    """Judge a run by its estimates and how its walkers went.

    Parameters
    ----------
    settings : Settings
        As given.
    measured : Measured
        Estimates.
    points : ndarray
        Kept positions of the last part of the run, one in `stride` steps, shape (E, T, W, d).
    acceptance : ndarray
        Accepted share of each walker's proposals, shape (E W,).
    stride, spanned : int
        Steps between kept positions, and steps that all parts span.

    Returns
    -------
    Gate
        Passed where the run spans `_TIMES_NEEDED` autocorrelation times of its slowest quantity,
        every walker moves, and the ensembles agree on every quantity.
    """
    names = measured.names
    ensembles, length, walkers, _ = points.shape
    slowest = int(np.argmax(measured.times))
    longest_time = float(measured.times[slowest])
    least_agreed = int(np.argmax(measured.rhats))
    rhat = float(measured.rhats[least_agreed])
    relative = measured.errors / measured.scale
    worst = int(np.argmax(relative))
    error = float(relative[worst])
    times_run = length / longest_time
    reasons = []
    if times_run < _TIMES_NEEDED:
        advice = ""
        if math.isfinite(longest_time):
            steps = _ADVISED_MARGIN * _TIMES_NEEDED * longest_time * stride
            enough = max(_LEAST_GROWTH * settings.most_steps, steps)
            rounded = math.ceil(enough / 1000) * 1000
            advice = f" most_steps = {rounded} gives it more (now {settings.most_steps})."
        reasons.append(
            f"the run spans {times_run:.1f} autocorrelation times of its slowest quantity,"
            f" {names[slowest]}; {_TIMES_NEEDED:g} are needed.{advice}"
        )
    lowest_acceptance = float(acceptance.min())
    still = int((np.ptp(points[:, length // 2 :, :, 0], axis=1) == 0).sum())
    if still:
        who = "1 walker" if still == 1 else f"{still} walkers"
        reasons.append(f"{who} did not move in the second half of the run.")
    elif lowest_acceptance < _STUCK:
        reasons.append(f"a walker is stuck: it accepted {lowest_acceptance:.2%} of its proposals.")
    # Negated, so that NaN fails too.
    if not rhat < _RHAT_LIMIT:
        reasons.append(
            f"the ensembles disagree on {names[least_agreed]}: rank R-hat {rhat:.4f}, limit"
            f" {_RHAT_LIMIT}."
        )
    if not np.isfinite(error):
        reasons.append(f"{names[worst]} has no finite Monte Carlo error.")
    error_reached = ""
    if not error <= settings.tolerance:
        error_reached = (
            f"The Monte Carlo error reached is {100 * error:.3g} % of a half-width"
            f" ({names[worst]}), and {100 * settings.tolerance:.3g} % was requested. A larger"
            f" most_steps (now {settings.most_steps}) lowers it."
        )
    return Gate(
        passed=not reasons,
        reasons=tuple(reasons),
        rhat=rhat,
        autocorrelation_time=longest_time * stride,
        slowest=names[slowest],
        times_run=times_run,
        # Of all parts of the run, where `times_run` speaks of the last one.
        effective_draws=ensembles * walkers * (spanned / stride) / longest_time,
        acceptance=float(acceptance.mean()),
        lowest_acceptance=lowest_acceptance,
        worst_error=error,
        worst=names[worst],
        tolerance_met=not error_reached,
        error_reached=error_reached,
    )
