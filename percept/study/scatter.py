"""Scatter that no posterior can be sampled from: none at all, or both parameters in proportion."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.statistics import Statistics
from percept.sessions.values import UNITS
from percept.study.units import NAMES

Array = NDArray[np.float64]
#: Remainder of a regression over what is regressed, below which the two are in proportion. Values printed to
#: six figures leave 1e-6; at 5e-3 the sampler's 20 000 steps were too few already.
_PROPORTION = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Lacking:
    """Cells whose scatter the step of the adjustment has to make up for."""

    between: NDArray[np.bool_]  # (P, J)
    trial: NDArray[np.bool_]  # (P, J)


def lacking_scatter(statistics: Statistics, steps: Collection[str]) -> Lacking:
    """Find cells without scatter, and pairs that move in proportion; refuse those without a step.

    Near a correlation of one the density of pairs in proportion grows as (1 - rho²)^(-(f - 1)/2) for every
    environment's f degrees of freedom; from four such half powers on no prior of rho holds it. A remainder
    ends that growth, too near one for walkers to follow where it is small.
    """
    between = (statistics.sd == 0) & (statistics.df > 0)
    trial = ((statistics.trial_rows**2).sum(axis=1) == 0) & (statistics.trial_df > 0)
    known = np.array([parameter in steps for parameter in statistics.parameters])[:, None]
    for what, still in (("all subjects adjusted alike", between), ("no subject's trials differ", trial)):
        _refuse_still(statistics, still & ~known, what)
    if len(statistics.parameters) == 2:
        centred = [
            cell - np.nanmean(cell, axis=1, keepdims=True)
            for cell in statistics.cell_means.transpose(2, 1, 0)
        ]
        means = [part[:, np.isfinite(part).all(axis=0)] for part in centred]
        trials = list(statistics.trial_rows.transpose(2, 0, 1))
        for what, scatter, df, lacking in (
            ("the subjects' means", means, statistics.df.min(axis=0), between),
            ("a subject's trials", trials, statistics.trial_df, trial),
        ):
            if _in_proportion(scatter, df):
                if not known.any():
                    _refuse_proportion(what)
                lacking |= df > 0
    return Lacking(between & known, trial & known)


def _refuse_still(statistics: Statistics, still: NDArray[np.bool_], what: str) -> None:
    for parameter, cells in zip(statistics.parameters, still, strict=True):
        if cells.any():
            names = ", ".join(statistics.environments[j] for j in np.flatnonzero(cells))
            raise RefusalError(
                f"{what} in {NAMES[parameter]} of {names}: zero scatter has no proper posterior.",
                column=f"{parameter}_adj",
                hint=f"Give the adjustment's step in {UNITS[parameter]}: [model] resolution.{parameter}.",
            )


def _in_proportion(scatter: list[Array], df: Array) -> bool:
    """Say whether in every environment the two rows of the scatter (2, n) are multiples of one another."""
    signs, powers = set(), 0.0
    for (first, second), freedom in zip(scatter, df, strict=True):
        if freedom < 1:
            continue
        cross, square, size = first @ second, first @ first, np.linalg.norm(second)
        if square == 0 or size == 0 or np.linalg.norm(second - cross / square * first) > _PROPORTION * size:
            return False
        signs.add(np.sign(cross))
        powers += freedom - 1.0
    return len(signs) == 1 and powers >= 4.0


def _refuse_proportion(what: str) -> NoReturn:
    raise RefusalError(
        f"stiffness and damping of {what} move in proportion, to within {_PROPORTION:.1%}, in every "
        "environment: a correlation of one has no proper posterior.",
        column="b_adj",
        hint="Analyse one of them, [inference] parameters, or give the steps: [model] resolution.",
    )
