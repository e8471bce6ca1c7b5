"""Interval limits of a study, with what finding them took: percept's, as its peers give them."""

from __future__ import annotations

import time
from dataclasses import dataclass

from percept.inference.model.limits import Limits
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from reports.studies import Array, Observed, model_of

KINDS = ("mean", "user")
LEVEL = 0.99
_MOST_STEPS = 2_000_000  # So that only the tolerance ends a run


@dataclass(frozen=True, eq=False)
class Fitted:
    """One run of a sampler: limits on the response scale, and what it took."""

    value: Array  # (2, 2, C) Kinds, lower and upper, cells (parameter-major)
    error: Array  # (2, 2, C) Monte Carlo standard errors
    effective: float  # Effective draws of the slowest quantity behind them
    seconds: float  # Wall time of sampling and of the limits, without compiling
    notes: dict[str, float]  # What its user would look at: divergences, acceptance, steps


def by_percept(study: Observed, tolerance: float, seed: int) -> Fitted:
    """Sample by percept to a tolerance.

    Parameters
    ----------
    study : Observed
        The study.
    tolerance : float
        Largest Monte Carlo error over half-width.
    seed : int
        Of the run.

    Returns
    -------
    Fitted
        `passed` among its notes says whether the gate passed.
    """
    started = time.perf_counter()
    estimands = estimands_of(study)
    model = estimands.model
    run = sample(model, estimands, Settings(tolerance=tolerance, seed=seed, most_steps=_MOST_STEPS))
    gate = run.gate
    shape = (len(KINDS), 2, len(model.cells))
    notes = {
        "passed": float(gate.passed),
        "error": gate.worst_error,
        "steps": float(run.steps),
        "tau": gate.autocorrelation_time,
        "R-hat": gate.rhat,
    }
    return Fitted(
        run.estimates.value.reshape(shape),
        run.estimates.errors.reshape(shape),
        gate.effective_draws,
        time.perf_counter() - started,
        notes,
    )


def estimands_of(study: Observed) -> Limits:
    """Return the limits that are compared."""
    return Limits(model_of(study), kinds=KINDS, level=LEVEL)
