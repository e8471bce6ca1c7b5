"""Scatter that no posterior can be sampled from: none at all, or both parameters in proportion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.statistics import Statistics
from percept.scene import Scene
from percept.study.units import NAMES, UNITS

__all__ = ["refuse_degenerate"]

Array = NDArray[np.float64]
#: Remainder of a regression over what is regressed, below which the two are in proportion. Values printed to
#: six figures leave 1e-6; at 5e-3 the sampler's 20 000 steps were too few already.
_PROPORTION = 1e-3


def refuse_degenerate(statistics: Statistics, scene: Scene) -> None:
    """Refuse cells without scatter, and pairs that move in proportion, unless the scene gives steps.

    Near a correlation of one the density of pairs in proportion grows as (1 - rho²)^(-(f - 1)/2) for every
    environment's f degrees of freedom; from four such half powers on no prior of rho holds it. A remainder
    ends that growth, too near one for walkers to follow where it is small.

    Parameters
    ----------
    statistics : Statistics
        The study.
    scene : Scene
        `model.resolution` holds the steps of the adjustments.

    Raises
    ------
    RefusalError
        Naming parameter, environments and the remedy.
    """
    steps = scene.model.resolution
    for p, parameter in enumerate(statistics.parameters):
        if parameter in steps:
            continue
        _refuse_still(
            statistics,
            parameter,
            (statistics.sd[p] == 0) & (statistics.df[p] > 0),
            "all subjects adjusted alike",
        )
        within = (statistics.trial_rows[p] ** 2).sum(axis=0)
        _refuse_still(
            statistics, parameter, (within == 0) & (statistics.trial_df > 0), "no subject's trials differ"
        )
    if len(statistics.parameters) < 2 or steps:
        return
    centred = [
        cell - np.nanmean(cell, axis=1, keepdims=True) for cell in statistics.cell_means.transpose(2, 1, 0)
    ]
    between = [part[:, np.isfinite(part).all(axis=0)] for part in centred]
    _refuse_proportion(between, statistics.df.min(axis=0), "the subjects' means")
    _refuse_proportion(
        list(statistics.trial_rows.transpose(2, 0, 1)), statistics.trial_df, "a subject's trials"
    )


def _refuse_still(statistics: Statistics, parameter: str, still: NDArray[np.bool_], what: str) -> None:
    if not still.any():
        return
    names = ", ".join(statistics.environments[j] for j in np.flatnonzero(still))
    raise RefusalError(
        f"{what} in {NAMES[parameter]} of {names}: zero scatter has no proper posterior.",
        column=f"{parameter}_adj",
        hint=f"Give the step of the adjustment in {UNITS[parameter]}: [model] resolution.{parameter}.",
    )


def _refuse_proportion(scatter: list[Array], df: Array, what: str) -> None:
    """Refuse when in every environment the two rows of the scatter (2, n) are multiples of one another."""
    signs, powers = set(), 0.0
    for (first, second), freedom in zip(scatter, df, strict=True):
        if freedom < 1:
            continue
        cross, square, size = first @ second, first @ first, np.linalg.norm(second)
        if square == 0 or size == 0 or np.linalg.norm(second - cross / square * first) > _PROPORTION * size:
            return
        signs.add(np.sign(cross))
        powers += freedom - 1.0
    if len(signs) == 1 and powers >= 4.0:
        raise RefusalError(
            f"stiffness and damping of {what} move in proportion, to within {_PROPORTION:.1%}, in every "
            "environment: a correlation of one has no proper posterior.",
            column="b_adj",
            hint="Analyse one of them, [inference] parameters, or give the steps: [model] resolution.",
        )
