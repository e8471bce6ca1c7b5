"""Posterior probability that a bias is smaller than one JND, and the verdict it gives."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy import special

from percept.results import EquivalenceRow
from percept.study.basics import Array, Skipped
from percept.study.data import Data
from percept.study.fit import Fit
from percept.study.psychophysics.equivalence import Limits, limits_of, outcome_of

__all__ = ["posterior_equivalence"]

#: Monte Carlo errors by which a probability must pass the one that decides.
_SURE = 2.0


def posterior_equivalence(fit: Fit, data: Data) -> Iterator[EquivalenceRow | Skipped]:
    """Yield the verdict on every cell of a fit that passed."""
    asked = data.asked
    trial_sds = _trial_sds(fit)
    for cell, c in fit.column.items():
        parameter, environment = cell
        quantity = fit.quantities[parameter]
        jnd = data.scene.study.jnd.get(parameter)
        if jnd is None:
            continue
        limits: Limits | Skipped | None = None
        if jnd != "trials":
            limits = limits_of(quantity, environment, jnd, data.reference[cell])
        elif cell not in trial_sds:
            what = f"whether {quantity.label} of {environment} is within one JND from trials"
            limits = Skipped(what, "without repeated trials there is none")
        if isinstance(limits, Skipped):
            yield limits
            continue
        ends = _trial_ends(fit, trial_sds[cell]) if limits is None else _ends(fit, limits, c)
        mean = fit.moments.mean[:, c]
        sd = fit.moments.sd[:, c]
        below_lower = special.ndtr((ends[0] - mean) / sd)
        below_upper = special.ndtr((ends[1] - mean) / sd)
        inside = below_upper - below_lower
        probability = float(inside.mean())
        error = float(inside.std()) / math.sqrt(len(fit.points))
        decisive = asked.decision + _SURE * error
        yield EquivalenceRow(
            environment=environment,
            parameter=parameter,
            method="bayesian",
            family=asked.family,
            outcome=outcome_of(
                within=probability >= decisive,
                beyond=1.0 - probability >= decisive,
            ),
            jnd=None if limits is None else limits.jnd,
            unit=quantity.unit,
            reference=data.reference[cell],
            decision=asked.decision,
            probability=probability,
            error=error,
            p_within=None,
            p_beyond=None,
        )


def _ends(fit: Fit, limits: Limits, c: int) -> tuple[float, float]:
    """Return the limits of a cell on the response scale."""
    origin = float(fit.scale.origin[c])
    unit = float(fit.scale.unit[c])
    lower, upper = limits.native
    if fit.scale.log:
        lower, upper = limits.log
        origin = math.log(origin)
    return (lower - origin) / unit, (upper - origin) / unit


def _trial_ends(fit: Fit, sd: Array) -> tuple[Array, Array]:
    """Return each draw's limits on the response scale, one SD between trials (S,) off."""
    if not fit.scale.log:
        return -sd, sd
    # As far below the reference as above it, in the quantity's unit.
    below = np.maximum(2.0 - np.exp(sd), 0.0)
    with np.errstate(divide="ignore"):
        return np.log(below), sd


def _trial_sds(fit: Fit) -> dict[tuple[str, str], Array]:
    """Return every cell's draws of the SD between trials; empty without repeats."""
    points = fit.run.points.reshape(len(fit.moments.mean), -1)
    sds: dict[tuple[str, str], Array] = {}
    for density, coordinates in fit.model.split(points):
        named = density.scales(coordinates)
        if "sigma_e" not in named:
            continue
        _, draws = named["sigma_e"]
        by_cell = draws.reshape(len(draws), -1).T
        sds |= dict(zip(density.cells, by_cell, strict=True))
    return sds
