"""What a linear design says of environments nobody was tested in, and of its trend over them.

A condition is a level of every factor. In each condition the locations scatter about a line over
the decades of the reference. An untested environment has one cell in each condition: its location
is on the line but for the environment's own deviations, whose SDs are tau. Its log SDs between
subjects scatter about their own columns, with SD omega.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.model.design import Design, cell_columns, new_cells, trend_rows
from percept.inference.model.laws import (
    NewEnvironment,
    TrendLaw,
    covariances,
    even_normals,
    joined,
)
from percept.inference.model.linear import LinearModel
from percept.inference.model.linear_scales import LinearScales, effect_columns
from percept.inference.model.model import MORE_ENVIRONMENTS, ONE_ENVIRONMENT

__all__ = ["linear_new_environment", "linear_trends"]

Array = NDArray[np.float64]

#: An intercept, at the geometric mean of the references, and a slope per decade.
_LINE_COEFFICIENTS = 2


def linear_trends(model: LinearModel, points: Array) -> dict[str, TrendLaw]:
    """Law of bias over decades of the reference.

    Parameters
    ----------
    model : LinearModel
        Of several environments.
    points : ndarray
        Coordinates (W, d).

    Returns
    -------
    dict of str to TrendLaw
        By condition.

    Raises
    ------
    RefusalError
        With one environment.
    """
    _refuse_one_environment(model)
    rows = trend_rows(model.design, model.priors)
    stacked = np.concatenate(list(rows.values()))
    shape = (len(rows), _LINE_COEFFICIENTS, model.design.parameters)
    parts = []
    for part in model.passes(points):
        law = model.locations(model.linear_scales(part).cells)
        mean, columns = law.fixed(stacked)
        by_line = columns.reshape(len(part), *shape, -1)
        parts.append(
            TrendLaw(
                mean=mean.reshape(len(part), *shape).swapaxes(2, 3),
                covariance=np.einsum("wcapk,wcbpk->wcpab", by_line, by_line),
            )
        )
    of_conditions = joined(parts)
    laws = {}
    for number, name in enumerate(rows):
        mean = of_conditions.mean[:, number]
        laws[name] = TrendLaw(mean, of_conditions.covariance[:, number])
    return laws


def linear_new_environment(
    model: LinearModel,
    points: Array,
    x: Array,
    repeats: int,
    rng: np.random.Generator,
) -> dict[str, NewEnvironment]:
    """Laws of an untested environment.

    Parameters
    ----------
    model : LinearModel
        Of several environments.
    points : ndarray
        Coordinates (W, d).
    x : ndarray
        Decades of its references above the geometric mean of those tested, (P,).
    repeats : int
        Draws of its SDs between subjects for each set of coordinates.
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    dict of str to NewEnvironment
        By condition, each of W repeats draws.

    Raises
    ------
    RefusalError
        With one environment.
    """
    _refuse_one_environment(model)
    design = new_cells(model.design, x, model.priors)
    laws = {}
    for number, name in enumerate(design.cells.names):
        cell = design.at(np.array([number]))
        parts = [_new_cell(model, part, cell, repeats, rng) for part in model.passes(points)]
        laws[name] = joined(parts)
    return laws


def _refuse_one_environment(model: LinearModel) -> None:
    if len(model.design.cells.environments) < 2:
        raise RefusalError(ONE_ENVIRONMENT, hint=MORE_ENVIRONMENTS)


def _new_cell(
    model: LinearModel,
    points: Array,
    cell: Design,
    repeats: int,
    rng: np.random.Generator,
) -> NewEnvironment:
    """Laws of a design's one new cell."""
    scales = model.linear_scales(points)
    mean, covariance = _new_location(model, scales, cell)
    effects = effect_columns(scales.effects, cell, len(points))[:, :, 0]  # (q, P, W)
    of_effects = np.einsum("qpw,qrw->wpr", effects, effects)
    within_cell = _new_spread(model, scales, cell, repeats, rng)
    population = of_effects[:, None] + within_cell
    return NewEnvironment(
        mean=np.repeat(mean, repeats, axis=0),
        covariance=np.repeat(covariance, repeats, axis=0),
        population=population.reshape(-1, *of_effects.shape[1:]),
    )


def _new_location(
    model: LinearModel,
    scales: LinearScales,
    cell: Design,
) -> tuple[Array, Array]:
    """Mean (W, P) and covariance (W, P, P) of the location of a new cell."""
    rows = [np.diag(column) for column in cell_columns(cell.fixed)]
    law = model.locations(scales.cells)
    mean, columns = law.fixed(np.concatenate(rows, axis=1))
    covariance = np.einsum("wpq,wrq->wpr", columns, columns)
    deviation_columns = cell_columns(cell.deviation)
    tau_squared = scales.cells.tau**2
    deviation_variance = np.einsum("op,opw->wp", np.square(deviation_columns), tau_squared)
    diagonal = np.arange(model.design.parameters)
    covariance[:, diagonal, diagonal] += deviation_variance
    return mean, covariance


def _new_spread(
    model: LinearModel,
    scales: LinearScales,
    cell: Design,
    repeats: int,
    rng: np.random.Generator,
) -> Array:
    """Covariances (W, repeats, P, P) of users within the cell, log sigma drawn about its mean."""
    level = model.coordinates.between
    named = scales.named
    columns = cell_columns(cell.sd_between)
    log_sigma = np.asarray(model.priors.log_s_mean)
    for name, column in zip(level.coefficients, columns, strict=True):
        # The columns carry the prior SDs of their coefficients.
        over_prior_sd = named[name] / model.coordinates.coefficient_sd(name)
        log_sigma = log_sigma + column[:, None] * over_prior_sd
    width = len(scales.log_prior)
    normals = even_normals(repeats, model.design.parameters, width, rng)  # (repeats, P, W)
    if level.departures:
        log_sigma = log_sigma + named["omega"] * normals
    else:
        log_sigma = log_sigma + np.zeros_like(normals)
    sigma = np.exp(log_sigma)
    draws_first = np.moveaxis(sigma, -1, 0)
    return covariances(draws_first, named.get(level.rho))
