"""The gate: whether a run has mixed, so that its numbers may be reported, and what error they have."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.judgement import Judged
from percept.inference.sampling.records import Gate, Settings

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
    """Judge a run."""
    relative = judged.errors / judged.estimates.scale
    worst = int(np.argmax(relative))
    name = judged.estimates.names[worst]
    times_run = length / judged.slowest
    reasons = []
    if not times_run >= TIMES_NEEDED:
        reasons.append(
            f"the run spans {times_run:.1f} autocorrelation times of its slowest quantity; "
            f"{TIMES_NEEDED:g} are needed. A larger most_steps (now {settings.most_steps}) adds some."
        )
    if not moved.all():
        reasons.append(f"{int((~moved).sum())} walkers did not move in the second half of the run.")
    elif acceptance.min() < _STUCK:
        reasons.append(f"a walker is stuck: it accepted {acceptance.min():.2%} of its proposals.")
    if judged.rhat is not None and not judged.rhat < _RHAT_LIMIT:
        reasons.append(f"the ensembles disagree: rank R-hat {judged.rhat:.4f}, limit {_RHAT_LIMIT}.")
    if not np.isfinite(relative[worst]):
        reasons.append(f"{name} has no finite Monte Carlo error.")
    met = bool(relative[worst] <= settings.tolerance)
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
        tolerance_met=met,
        error_reached="" if met else _error_reached(float(relative[worst]), name, settings),
    )


def _error_reached(error: float, name: str, settings: Settings) -> str:
    """Say which error a run ended with where it misses the tolerance."""
    return (
        f"The Monte Carlo error reached is {100 * error:.3g} % of a half-width ({name}) where "
        f"{100 * settings.tolerance:.3g} % was asked. "
        f"A larger most_steps (now {settings.most_steps}) lowers it."
    )
