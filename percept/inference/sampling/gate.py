"""The gate: how far estimates can be believed, whether a run's numbers may be reported, and why not."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.inference.sampling.diagnostics import (
    autocorrelation_time,
    monte_carlo_error,
    normal_scores,
    rank_rhat,
    some_walkers,
    split_rhat,
)
from percept.inference.sampling.estimands import Estimands, Estimates

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """How to sample."""

    tolerance: float = 0.01
    seed: int = 1  # Seed of the whole run
    ensembles: int = 4  # Independent ensembles, at least 4
    walkers: int | None = None  # Walkers per ensemble
    most_steps: int = 20_000  # Steps per ensemble at which the run ends, whatever its error

    def __post_init__(self) -> None:
        walkers = self.walkers is None or self.walkers >= 64
        for key, holds, rule in (
            ("tolerance", 0.0 < self.tolerance < 1.0, "must lie in (0, 1)."),
            ("ensembles", self.ensembles >= 4, "must be at least 4."),
            ("seed", self.seed >= 0, "must be zero or positive."),
            ("most_steps", self.most_steps >= 1, "must be at least 1."),
            ("walkers", walkers, "must be at least 64."),
        ):
            if not holds:
                raise UsageError(rule, key=key, value=getattr(self, key))


@dataclasses.dataclass(frozen=True)
class Gate:
    """Verdict on a run."""

    passed: bool  # Whether the run has mixed, so that its numbers may be reported with their errors
    reasons: tuple[str, ...]  # What failed
    rhat: float  # Largest rank R-hat across ensembles
    autocorrelation_time: float  # Longest autocorrelation time of a reported quantity, in steps
    slowest: str  # The quantity it belongs to
    times_run: float  # Kept steps per ensemble over that time, of a long run's last part
    effective_draws: float  # Effective draws of the slowest reported quantity
    acceptance: float  # Mean acceptance fraction
    lowest_acceptance: float  # Of the slowest walker
    worst_error: float  # Largest Monte Carlo error over half-width
    worst: str  # The estimate it belongs to
    tolerance_met: bool  # Whether that error is within the tolerance
    error_reached: str  # A sentence on the error where it misses the tolerance, else empty


#: Batches of walkers in an ensemble.
_GROUPS = 8
#: Values whose ranks are compared: chance alone then leaves R-hat within 0.001 of one.
_RANKED = 1 << 14
#: Normal score beyond which a draw lies in a tail: a twentieth of the draws at either end.
_TAIL = 1.645


@dataclasses.dataclass(frozen=True)
class Progress:
    """State of a run, told after every round."""

    steps: int  # Steps per ensemble so far
    expected_steps: int  # Steps per ensemble the run is expected to need
    worst_error: float  # NaN before the first round is judged
    tolerance: float
    seconds_left: float = math.nan  # For whoever watches; it decides nothing
    quicker: str = ""  # What would make the run shorter


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """A finished run."""

    points: Array  # (E, T, W, d) Kept coordinates, one in `stride` steps
    components: Array  # (E, T, W, C) What the estimands keep per draw
    estimates: Estimates  # What was asked for
    errors: Array  # (Q,) Monte Carlo standard errors
    times: Array  # (Q,) Autocorrelation times of the ranks of the influence functions, in steps
    gate: Gate  # The verdict
    steps: int
    stride: int
    settings: Settings  # As asked

    def _independent_positions(self) -> NDArray[np.intp]:
        """Kept positions about an autocorrelation time apart."""
        length = self.points.shape[1]
        gap = max(1, round(self.gate.autocorrelation_time / self.stride))
        return np.arange(gap - 1, length, gap) if length >= gap else np.array([length - 1])

    def independent(self) -> Array:
        """Return kept positions thinned to the effective size, walkers flattened into steps, (E, N, d)."""
        kept = self.points[:, self._independent_positions()]
        return kept.reshape(len(kept), -1, kept.shape[-1])

    def batches(self) -> NDArray[np.intp]:
        """Return the number of the batch of each of the `independent` positions, ensemble after ensemble.

        A batch holds some walkers of an ensemble at all their steps: what a walker remembers stays
        in it.
        """
        ensembles, _, walkers, _ = self.points.shape
        groups = np.tile(
            np.arange(walkers) * _GROUPS // walkers, self._independent_positions().size
        )
        return (np.arange(ensembles)[:, None] * _GROUPS + groups).ravel()


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """Estimates and how far they can be believed."""

    estimates: Estimates  # Q estimates
    errors: Array  # (Q,) Monte Carlo standard errors
    times: Array  # (Q,) Autocorrelation times of the influence functions' ranks, in kept positions
    rhats: Array  # (Q,) Rank R-hat of the influence functions across ensembles


def judge(estimands: Estimands, components: Array) -> Judged:
    """Estimate, and measure errors and convergence."""
    estimates, *measures = zip(
        *(
            (found, *_measured(influence.reshape(*components.shape[:3], -1)))
            for found, influence in estimands.estimates(
                components.reshape(-1, components.shape[-1])
            )
        ),
        strict=True,
    )
    names = tuple(name for found in estimates for name in found.names)
    value, scale = (np.concatenate([getattr(e, n) for e in estimates]) for n in ("value", "scale"))
    return Judged(Estimates(names, value, scale), *map(np.concatenate, measures))


def _measured(series: Array) -> tuple[Array, Array, Array]:
    """Errors of influence functions (E, T, W, Q), and times and R-hat of their ranks."""
    errors = monte_carlo_error(series, autocorrelation_time(some_walkers(series)))
    # Ranks: a heavy tail would make the memory that of its few extreme draws, and hide what is slow
    # below it.
    scores = normal_scores(some_walkers(series, _RANKED))
    tail = (np.abs(scores) > _TAIL).astype(float)
    times = np.maximum(autocorrelation_time(scores), autocorrelation_time(tail))
    # R-hat at about every independent position.
    ensembles, length, _, count = scores.shape
    gap = max(1, round(min(float(times.max()), length / 4.0)))
    ranked, tails = (part[:, ::gap].reshape(ensembles, -1, count) for part in (scores, tail))
    return errors, times, np.maximum(rank_rhat(ranked), split_rhat(tails))


#: Autocorrelation times a run must span; averaging over 64 walkers or more makes ten enough.
TIMES_NEEDED = 10.0
_RHAT_LIMIT = 1.01
_STUCK = 0.005  # acceptance below which a walker counts as stuck


def pass_gate(
    settings: Settings,
    judged: Judged,
    acceptance: Array,
    moved: NDArray[np.bool_],
    *,
    length: int,
    stride: int,
    spanned: int,
) -> Gate:
    """Judge a run."""
    relative = judged.errors / judged.estimates.scale
    worst, slow = int(np.argmax(relative)), int(np.argmax(judged.times))
    names = judged.estimates.names
    longest = float(judged.times[slow])
    times_run = length / longest
    reasons = []
    if not times_run >= TIMES_NEEDED:
        more = ""
        if math.isfinite(longest):
            # What a run too short shows of a time is too little.
            steps = float(
                f"{max(2.0 * settings.most_steps, 1.5 * TIMES_NEEDED * longest * stride):.1g}"
            )
            more = f" most_steps = {steps:.0f} gives it more (now {settings.most_steps})."
        reasons.append(
            f"the run spans {times_run:.1f} autocorrelation times of its slowest quantity,"
            f" {names[slow]}; {TIMES_NEEDED:g} are needed.{more}"
        )
    if not moved.all():
        reasons.append(f"{int((~moved).sum())} walkers did not move in the second half of the run.")
    elif acceptance.min() < _STUCK:
        reasons.append(f"a walker is stuck: it accepted {acceptance.min():.2%} of its proposals.")
    apart = int(np.argmax(judged.rhats))
    rhat = float(judged.rhats[apart])
    if not rhat < _RHAT_LIMIT:
        reasons.append(
            f"the ensembles disagree on {names[apart]}: rank R-hat {rhat:.4f}, limit {_RHAT_LIMIT}."
        )
    if not np.isfinite(relative[worst]):
        reasons.append(f"{names[worst]} has no finite Monte Carlo error.")
    error = float(relative[worst])
    met, asked = error <= settings.tolerance, 100 * settings.tolerance
    reached = (
        f"The Monte Carlo error reached is {100 * error:.3g} % of a half-width ({names[worst]})"
        f" where {asked:.3g} % was asked. A larger most_steps (now {settings.most_steps})"
        " lowers it."
    )
    return Gate(
        passed=not reasons,
        reasons=tuple(reasons),
        rhat=rhat,
        autocorrelation_time=longest * stride,
        slowest=names[slow],
        times_run=times_run,
        effective_draws=moved.size * (spanned / stride) / longest,
        acceptance=float(acceptance.mean()),
        lowest_acceptance=float(acceptance.min()),
        worst_error=error,
        worst=names[worst],
        tolerance_met=met,
        error_reached="" if met else reached,
    )
