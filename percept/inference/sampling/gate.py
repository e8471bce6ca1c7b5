"""The gate: whether a run's numbers may be reported, and why not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.diagnostics import rank_rhat, some_walkers
from percept.inference.sampling.estimands import Estimates
from percept.inference.sampling.records import Gate, Settings

__all__ = ["TIMES_NEEDED", "pass_gate"]

Array = NDArray[np.float64]
#: Autocorrelation times a run must span; averaging over 64 walkers or more makes ten enough.
TIMES_NEEDED = 10.0
_RHAT_LIMIT = 1.01
_STUCK = 0.005  # acceptance below which a walker counts as stuck


def pass_gate(
    settings: Settings,
    estimates: Estimates,
    errors: Array,
    watched: Sequence[Array],
    slowest: float,
    acceptance: Array,
    moved: NDArray[np.bool_],
    *,
    stride: int,
    spanned: int,
    full: bool,
) -> Gate:
    """Judge a run.

    Parameters
    ----------
    settings : Settings
        Tolerance.
    estimates : Estimates
        Estimates and their scales.
    errors : ndarray, shape (Q,)
        Their Monte Carlo errors.
    watched : sequence of ndarray, each (E, T, W, V)
        Series that must have converged; those of all walkers first.
    slowest : float
        Longest of their autocorrelation times, in kept positions.
    acceptance : ndarray, shape (E, W)
        Acceptance of every walker over the whole run.
    moved : ndarray of bool, shape (E, W)
        Whether each walker moved in the second half of the kept positions.
    stride : int
        Steps between kept positions.
    spanned : int
        Steps of the whole run, of which the series may be the last part.
    full : bool
        Whether the series cannot go on: R-hat is then worked out whatever else failed.

    Returns
    -------
    Gate
    """
    relative = errors / estimates.scale
    worst = int(np.argmax(relative))
    ensembles, length, walkers, _ = watched[0].shape
    times_run = length / slowest
    reasons = []
    if not times_run >= TIMES_NEEDED:
        reasons.append(
            f"the run spans {times_run:.1f} autocorrelation times of its slowest quantity; "
            f"{TIMES_NEEDED:g} are needed."
        )
    if not moved.all():
        reasons.append(f"{int((~moved).sum())} walkers did not move in the second half of the run.")
    elif acceptance.min() < _STUCK:
        reasons.append(f"a walker is stuck: it accepted {acceptance.min():.2%} of its proposals.")
    accurate = bool(relative[worst] <= settings.tolerance)
    rhat = None
    if full or (accurate and not reasons):
        gap = max(1, round(min(slowest, length / 4.0)))
        apart = [some_walkers(series[:, ::gap]) for series in watched]
        rhat = float(max(rank_rhat(part.reshape(ensembles, -1, part.shape[3])).max() for part in apart))
        if not rhat < _RHAT_LIMIT:
            reasons.append(f"the ensembles disagree: rank R-hat {rhat:.4f}, limit {_RHAT_LIMIT}.")
    if not accurate:
        reasons.append(
            f"{estimates.names[worst]} has a Monte Carlo error of {relative[worst]:.2%} of its "
            f"half-width; {settings.tolerance:.2%} was asked. Raise the cap on steps or the tolerance."
        )
    return Gate(
        passed=not reasons,
        reasons=tuple(reasons),
        rhat=rhat,
        autocorrelation_time=slowest * stride,
        times_run=times_run,
        effective_draws=ensembles * (spanned / stride) * walkers / slowest,
        acceptance=float(acceptance.mean()),
        lowest_acceptance=float(acceptance.min()),
        worst_error=float(relative[worst]),
        worst=estimates.names[worst],
    )
