"""What a model says of what nobody has measured: untested environments, and anything before data.

A condition is a level of every factor. In each condition the locations scatter about a line over
the decades of the reference. An untested environment has one cell in each condition: its location
is on the line but for the environment's own deviations, whose SDs are tau. Its log SDs between
subjects scatter about their own columns, with SD omega.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from percept.errors import RefusalError
from percept.inference.model.design import Design, columns_by_quantity, new_cells
from percept.inference.model.laws import Joint, joined
from percept.inference.model.model import LinearModel, Model
from percept.inference.model.priors import Named
from percept.inference.model.scales import Scales, effect_columns

__all__ = ["draw_prior", "new_environment", "new_name", "trend_rows"]

Array = NDArray[np.float64]

#: Real root of x³ = x + 1: multiples of its powers fill the square evenly (Roberts 2018), which
#: `scipy.stats.qmc` does for numbers of points that are powers of two alone.
_PLASTIC = 1.32471795724474602596
_STEPS_IN_SQUARE = _PLASTIC ** np.array([-1.0, -2.0])
#: Least probability whose normal score is taken: zero has none.
_LEAST_PROBABILITY = 1e-12


def new_name(condition: str) -> str:
    """Name the new environment in a condition."""
    return f"new ({condition})" if condition else "new"


def trend_rows(model: LinearModel) -> dict[str, Array]:
    """Weights (2, P, R) of the line over decades of the reference, by condition.

    First is its height at the geometric mean of the references tested, second its slope per decade.

    Raises
    ------
    RefusalError
        With one environment.
    """
    _refuse_one_environment(model)
    at_mean = np.zeros(model.design.parameters)
    centre = new_cells(model.design, at_mean, model.priors)
    a_decade_above = new_cells(model.design, at_mean + 1.0, model.priors)
    heights = _location_rows(model, centre)
    slopes = _location_rows(model, a_decade_above) - heights
    rows = np.stack([heights, slopes], axis=1)
    return dict(zip(centre.cells.names, rows, strict=True))


def _location_rows(model: LinearModel, design: Design) -> Array:
    """Weights (C, P, R) of the C cells of a design on the fixed terms' coefficients."""
    quantities, cells = design.cells.x.shape
    fixed = columns_by_quantity(design.fixed, quantities, cells)
    rows = np.zeros((cells, quantities, model.locations))
    # Coefficients are the last of the locations.
    rows[..., model.locations - len(fixed) :] = fixed.transpose(2, 1, 0)
    return rows


def new_environment(
    model: Model,
    points: Array,
    x: Array,
    *,
    repeats: int,
    rng: np.random.Generator,
) -> dict[str, Joint]:
    """Work out the laws of an untested environment in each condition, at posterior draws.

    Parameters
    ----------
    model : Model
        That pools environments.
    points : ndarray
        Coordinates of W draws, shape (W, d).
    x : ndarray
        Decades of the references above the geometric mean of those tested, shape (P,).
    repeats : int
        Spreads drawn for each draw: S = W · repeats.
    rng : Generator
        Where they come from.

    Returns
    -------
    dict of str to Joint
        Of the P quantities, by the levels of all factors; without factors there is one, with an
        empty name. Quantities of different models are uncorrelated.

    Raises
    ------
    RefusalError
        A model without pooling, or of one environment.
    """
    parts = []
    first = 0
    for linear, coordinates in model.split(points):
        _refuse_one_environment(linear)
        last = first + linear.design.parameters
        design = new_cells(linear.design, x[first:last], linear.priors)
        laws = [
            _new_laws(linear, part, design, repeats, rng) for part in linear.passes(coordinates)
        ]
        parts.append(dict(zip(design.cells.names, joined(laws).apart(), strict=True)))
        first = last
    if not parts:
        hint = 'Set pooling = "partial" in [model].'
        raise RefusalError("without pooling, an environment tells nothing about others.", hint=hint)
    conditions = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: _side_by_side([part[name] for part in parts]) for name in conditions}


def _side_by_side(parts: list[Joint]) -> Joint:
    """Put quantities of different models together, without correlation."""
    return Joint(
        mean=np.concatenate([part.mean for part in parts], axis=2),
        location=linalg.block_diag(*(part.location for part in parts)),
        users=linalg.block_diag(*(part.users for part in parts)),
    )


def _refuse_one_environment(model: LinearModel) -> None:
    """Refuse a study without a trend over environments."""
    if len(model.design.cells.environments) < 2:
        raise RefusalError(
            "one environment shows no trend to predict others from.",
            hint="Add sessions with more reference environments.",
        )


def _new_laws(
    model: LinearModel,
    points: Array,
    design: Design,
    repeats: int,
    rng: np.random.Generator,
) -> Joint:
    """Laws of a design's new cells, at the points of one pass."""
    scales = model.linear_scales(points)
    quantities, cells = design.cells.x.shape
    on_line = model.law(points).joint(_location_rows(model, design))
    deviation = columns_by_quantity(design.deviation, quantities, cells)
    variance = np.einsum("apc,aw->wcp", deviation**2, scales.cells.tau**2)
    location = on_line.location
    quantity = np.arange(quantities)
    location[..., quantity, quantity] += variance
    effects = effect_columns(scales.cells.covariances, scales.cells.sizes, design)
    of_effects = np.zeros((len(points), cells, quantities, quantities))
    for column in effects:
        of_effects += np.einsum("pcw,rcw->wcpr", column, column)
    sd = _new_sds(model, scales, design, repeats, rng)
    within_cell = sd[..., :, None] * sd[..., None, :]
    rho = scales.named.get(model.coordinates.between.rho)
    if rho is not None:
        within_cell[..., 0, 1] *= rho[:, None, None]
        within_cell[..., 1, 0] *= rho[:, None, None]
    users = of_effects[:, None] + within_cell
    return Joint(
        mean=np.repeat(on_line.mean, repeats, axis=0),
        location=np.repeat(location, repeats, axis=0),
        users=users.reshape(-1, cells, quantities, quantities),
    )


def _new_sds(
    model: LinearModel,
    scales: Scales,
    design: Design,
    repeats: int,
    rng: np.random.Generator,
) -> Array:
    """SDs (W, repeats, C, P) of users within new cells, log sigma drawn about its mean."""
    level = model.coordinates.between
    named = scales.named
    quantities, cells = design.cells.x.shape
    width = len(scales.log_prior)
    log_sigma = np.full((quantities, cells, width), model.priors.log_s_mean)
    columns = [column for term in design.sd_between for column in term.columns]
    for name, column in zip(level.coefficients, columns, strict=True):
        # The columns carry the prior SDs of their coefficients.
        over_prior_sd = named[name] / model.coordinates.coefficient_sd(name)
        log_sigma += column[..., None] * over_prior_sd[:, None]
    by_draw = np.repeat(log_sigma.T[:, None], repeats, axis=1)
    if level.departures:
        # Standard normals that fill the square evenly, `repeats` in turn for each draw.
        steps = np.multiply.outer(np.arange(width * repeats), _STEPS_IN_SQUARE[:quantities])
        uniforms = (steps[:, None] + rng.random((cells, quantities))) % 1.0
        normals = special.ndtri(np.clip(uniforms, _LEAST_PROBABILITY, 1.0 - _LEAST_PROBABILITY))
        omega = named["omega"].T[:, None, None]
        by_draw += omega * normals.reshape(by_draw.shape)
    return np.exp(by_draw)


def draw_prior(
    model: LinearModel,
    draws: int,
    rng: np.random.Generator,
) -> tuple[Named, Array, Array]:
    """Draw what a model says before any data.

    Parameters
    ----------
    model : LinearModel
        Whose design and priors are taken.
    draws : int
        Number of draws.
    rng : Generator
        Where they come from.

    Returns
    -------
    Named
        Scales and correlations by name.
    locations, users : ndarray
        Population means and new users of all cells, (draws, P C) each.
    """
    # Without observed scatter every coordinate is standard normal a priori.
    blank = LinearModel(model.statistics.without_scatter(), model.design, model.priors)
    points = rng.standard_normal((draws, len(blank.names)))
    rows = model.rows
    cells = len(model.cells)
    all_locations = []
    users = []
    for part in blank.passes(points):
        latent_sd = rows.latent_sd(blank.linear_scales(part).cells.tau)
        latents = latent_sd * rng.standard_normal(latent_sd.shape)
        locations = (rows.basis[:cells] @ latents).T
        columns = blank.law(part).user_columns(blank.cell_rows)
        normals = rng.standard_normal(columns[:, 0].shape)
        all_locations.append(locations)
        users.append(locations + np.einsum("wlk,wk->wl", columns, normals))
    return blank.scales(points), np.concatenate(all_locations), np.concatenate(users)
