"""Draws of a linear design before any data: scales, locations of cells, and new users.

Given scales, the locations of all cells are B xi with xi standard normal. The columns B of the
environments' deviations are multiplied by their SDs tau first; columns of fixed terms carry theirs
already. A new user adds Z v + F w with v and w standard normal: effects with columns Z, and in each
cell a departure with factor F of its covariance between subjects.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.cell_problem import CellProblem
from percept.inference.model.cell_scales import CellScales
from percept.inference.model.laws import PriorDraws
from percept.inference.model.linear import LinearModel

__all__ = ["draw_linear_prior"]

Array = NDArray[np.float64]


def draw_linear_prior(
    model: LinearModel,
    draws: int,
    rng: np.random.Generator,
) -> PriorDraws:
    """Draw scales, population means and new users before any data.

    Parameters
    ----------
    model : LinearModel
        Its design and priors count, and its responses do not.
    draws : int
        Number of draws.
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    PriorDraws
        Means and users on the response scale, (draws, P C).
    """
    blank = _without_scatter(model)
    points = rng.standard_normal((draws, len(blank.names)))
    means = []
    users = []
    for part in blank.passes(points):
        scales = blank.linear_scales(part).cells
        locations = _draw_locations(model.problem, scales, rng)
        means.append(locations)
        users.append(locations + _draw_departures(scales, rng))
    return PriorDraws(
        scales=blank.scales(points),
        means=np.concatenate(means),
        users=np.concatenate(users),
    )


def _without_scatter(model: LinearModel) -> LinearModel:
    """Return the model without observed scatter: every coordinate is standard normal a priori."""
    statistics = dataclasses.replace(
        model.statistics,
        sd=np.zeros_like(model.statistics.sd),
        trial_rows=np.zeros_like(model.statistics.trial_rows),
    )
    scatter = dataclasses.replace(
        model.scatter,
        rows=np.zeros_like(model.scatter.rows),
        response_rows=np.zeros_like(model.scatter.response_rows),
    )
    return LinearModel(statistics, model.design, model.priors, model.covariates, scatter)


def _draw_locations(
    problem: CellProblem,
    scales: CellScales,
    rng: np.random.Generator,
) -> Array:
    """Draw the locations of all cells, (W, P C)."""
    column_sd = problem.own_sd(scales.tau)
    # Environments are the faster index of the deviations, (columns J, W).
    deviation_sd = np.repeat(column_sd, problem.environments, axis=0)
    width = deviation_sd.shape[1]
    columns = problem.basis.shape[1]
    latents = rng.standard_normal((columns, width))
    latents[: problem.deviations] *= deviation_sd
    return np.asarray((problem.basis @ latents).T)


def _draw_departures(scales: CellScales, rng: np.random.Generator) -> Array:
    """Draw what a new user adds to the locations of all cells, (W, P C)."""
    count, *_, width = scales.effects.shape
    effects = rng.standard_normal((count, width))
    departures = np.einsum("qpcw,qw->pcw", scales.effects, effects)
    for parts in scales.between.factor_columns():
        factor_column = np.stack(parts)  # (P, C, W)
        normals = rng.standard_normal(factor_column.shape[1:])
        departures += factor_column * normals
    return departures.reshape(-1, width).T
