"""The gate: whether a run's numbers may be reported, and why not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.judgement import Judged
from percept.inference.sampling.records import Gate, Settings

__all__ = ["TIMES_NEEDED", "pass_gate"]

Array = NDArray[np.float64]
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
    """Judge a run.

    Parameters
    ----------
    settings : Settings
        Tolerance.
    judged : Judged
        Estimates of the whole run with their errors; R-hat and the slowest autocorrelation time are those of
        the positions at hand.
    acceptance : ndarray, shape (E, W)
        Acceptance of every walker over the whole run.
    moved : ndarray of bool, shape (E, W)
        Whether each walker moved in the second half of the kept positions.
    length, stride : int
        Kept positions of a walker, and steps between them.
    spanned : int
        Steps of the whole run, of which these positions may be the last part.

    Returns
    -------
    Gate
    """
    relative = judged.errors / judged.estimates.scale
    worst = int(np.argmax(relative))
    name = judged.estimates.names[worst]
    times_run = length / judged.slowest
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
    if judged.rhat is not None and not judged.rhat < _RHAT_LIMIT:
        reasons.append(f"the ensembles disagree: rank R-hat {judged.rhat:.4f}, limit {_RHAT_LIMIT}.")
    if not relative[worst] <= settings.tolerance:
        reasons.append(
            f"{name} has a Monte Carlo error of {relative[worst]:.2%} of its "
            f"half-width; {settings.tolerance:.2%} was asked. Raise the cap on steps or the tolerance."
        )
    return Gate(
        passed=not reasons,
        reasons=tuple(reasons),
        rhat=judged.rhat,
        autocorrelation_time=judged.slowest * stride,
        times_run=times_run,
        effective_draws=moved.size * (spanned / stride) / judged.slowest,
        acceptance=float(acceptance.mean()),
        lowest_acceptance=float(acceptance.min()),
        worst_error=float(relative[worst]),
        worst=name,
    )
