"""What a model says of what nobody has measured: untested environments, and anything before data.

A condition is a level of every factor. In each condition the locations scatter about a line over
the decades of the reference. An untested environment has one cell in each condition: its location
is on the line but for the environment's own deviations, whose SDs are tau. Its log SDs between
subjects scatter about their own columns, with SD omega.
"""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from percept.errors import RefusalError
from percept.inference.model.design import Design, columns_by_quantity, columns_of, new_cells
from percept.inference.model.gaussian import (
    Joint,
    SubjectCovariance,
    group_covariances,
    joined,
    user_columns,
)
from percept.inference.model.model import LinearModel, Model
from percept.inference.model.priors import Named
from percept.inference.model.scales import CellScales

Array = NDArray[np.float64]


def new_name(condition: str) -> str:
    """Name the new environment in a condition."""
    return f"new ({condition})" if condition else "new"


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
        if len(linear.design.cells.environments) < 2:
            raise RefusalError(
                "one environment shows no trend to predict others from.",
                hint="Add sessions with more reference environments.",
            )
        last = first + linear.design.parameters
        design = new_cells(linear.design, x[first:last], linear.priors)
        laws = [
            _new_laws(linear, part, design, repeats, rng) for part in linear.passes(coordinates)
        ]
        by_condition = joined(laws).apart()
        parts.append(dict(zip(design.cells.names, by_condition, strict=True)))
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


def _new_laws(
    model: LinearModel,
    points: Array,
    design: Design,
    repeats: int,
    rng: np.random.Generator,
) -> Joint:
    """Laws of a design's new cells, at the points of one pass."""
    scales = model.coordinates(points)
    quantities, cells = design.cells.x.shape
    fixed = columns_by_quantity(design.fixed, design.cells.x)
    rows = np.zeros((cells, quantities, model.locations))
    # Coefficients are the last of the locations.
    rows[..., -len(fixed) :] = fixed.T
    on_line = model.law(points).joint(rows)
    deviation = columns_by_quantity(design.deviation, design.cells.x)
    variance = np.einsum("apc,aw->wcp", deviation**2, scales.cells.tau**2)
    location = on_line.location
    quantity = np.arange(quantities)
    location[..., quantity, quantity] += variance
    columns = columns_of(design.sd_between, design.cells.x)
    # The columns carry the prior SDs of their coefficients.
    about_mean = np.einsum("kpc,pkw->pcw", columns, scales.multiples)
    log_sigma = np.repeat(model.priors.log_s_mean + about_mean, repeats, axis=2)
    named = _repeated(scales.named, repeats)
    if model.coordinates.between.departures:
        log_sigma += named["omega"][:, None] * rng.standard_normal(log_sigma.shape)
    named["sigma"] = np.exp(log_sigma)
    rests = _repeated(scales.rests, repeats)
    of_users = model.coordinates.cell_scales(named, rests, design)
    each_cell = np.eye(quantities * cells).reshape(quantities, cells, -1)
    return Joint(
        mean=np.repeat(on_line.mean, repeats, axis=0),
        location=np.repeat(location, repeats, axis=0),
        users=group_covariances(partial(user_columns, of_users), each_cell.swapaxes(0, 1)),
    )


def _repeated(
    by_name: dict[str, Array],
    repeats: int,
) -> dict[str, Array]:
    """Repeat draws, which are last in all arrays, each by itself."""
    return {name: np.repeat(values, repeats, axis=-1) for name, values in by_name.items()}


def draw_prior(
    model: LinearModel,
    draws: int,
    rng: np.random.Generator,
) -> tuple[Named, Array]:
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
    locations : ndarray
        Population means of all cells, (draws, P C).
    """
    # Without data all coordinates and latents are standard normal.
    observed = model.statistics
    no_squares = np.zeros_like(observed.scatter.squares)
    statistics = dataclasses.replace(
        observed,
        scatter=dataclasses.replace(observed.scatter, squares=no_squares),
        cell_means=np.zeros_like(observed.cell_means),
    )
    blank = LinearModel(statistics, model.design, model.priors)
    points = rng.standard_normal((draws, len(blank.names)))
    tau = blank.coordinates(points).cells.tau
    of_cells = blank.basis.matrix[: len(blank.cells)]
    latents = rng.standard_normal((draws, of_cells.shape[1]))
    environments = len(blank.design.cells.environments)
    latents[:, : blank.basis.deviations] *= np.repeat(tau, environments, axis=0).T
    return blank.scales(points), latents @ of_cells.T


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectLaws:
    """What W sets of scales say of subjects' cell means: P quantities in C cells."""

    mean: Array  # (P, C, W) Mean of the locations
    columns: Array  # (K, P, C, W) Columns whose products sum to the locations' covariance
    scales: CellScales  # What resolution adds included
    covariances: tuple[SubjectCovariance, ...]  # By pattern: of the cell means about the locations


def cells_of_subjects(model: LinearModel) -> NDArray[np.bool_]:
    """Find the cells of each subject's levels of the factors between subjects.

    Parameters
    ----------
    model : LinearModel
        Of N subjects in C cells.

    Returns
    -------
    ndarray of bool
        Shape (N, C); true throughout without such factors.
    """
    factors = model.design.factors
    subjects, _, cells = model.statistics.cell_means.shape
    belongs = np.ones((subjects, cells), dtype=bool)
    for name in factors.between_subjects:
        level = factors.level[name]
        for pattern in model.statistics.patterns:
            belongs[pattern.members] &= np.isin(level, level[pattern.environments])
    return belongs


def subject_laws(model: LinearModel, points: Array) -> SubjectLaws:
    """Work out the laws of all subjects' cell means.

    Parameters
    ----------
    model : LinearModel
        Of subjects.
    points : ndarray
        Coordinates (W, d), few enough for the processor's cache.

    Returns
    -------
    SubjectLaws
    """
    scales = model.with_resolution(model.coordinates(points).cells)
    law = model.law(points)
    covariances = []
    for pattern in model.statistics.patterns:
        cells = pattern.environments
        of_means = scales.between[cells]
        if scales.trial is not None:
            groups = model.statistics.group[pattern.members[0], cells]
            trial = scales.trial[groups]
            of_means = of_means + trial.scaled(1.0 / pattern.trials[:, None])
        covariances.append(SubjectCovariance(of_means, scales.effects[:, :, cells]))
    by_cell = (*model.design.cells.x.shape, len(points))  # (P, C, W)
    mean = law.mean[:, : len(model.cells)].T
    columns = law.columns(model.cell_rows).transpose(2, 1, 0)
    return SubjectLaws(
        mean=mean.reshape(by_cell),
        columns=columns.reshape(-1, *by_cell),
        scales=scales,
        covariances=tuple(covariances),
    )


def draw_subject_effects(
    model: LinearModel,
    points: Array,
    locations: Array,
    rng: np.random.Generator,
) -> Array | None:
    """Draw what every subject adds, averaged over the cells of its levels between subjects.

    Parameters
    ----------
    model : LinearModel
        Of subjects.
    points : ndarray
        Coordinates (W, d).
    locations : ndarray
        Locations of cells drawn there, (W, P C).
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    ndarray or None
        On the response scale, (W, N, P). None without such effects, and with covariates: the
        locations hold no slopes.
    """
    if model.statistics.covariates is not None or not model.design.subject:
        return None
    effects = np.empty((len(points), *model.statistics.cell_means.shape[:2]))
    own_cells = cells_of_subjects(model)
    passes = zip(
        model.passes(points),
        model.passes(locations),
        model.passes(effects),
        strict=True,
    )
    for part, of_cells, of_subjects in passes:
        laws = subject_laws(model, part)
        beta = of_cells.T.reshape(laws.mean.shape)  # (P, C, W)
        for pattern, covariance in zip(model.statistics.patterns, laws.covariances, strict=True):
            present = pattern.environments
            cell_means = model.statistics.cell_means[pattern.members][:, :, present, None]
            latents = covariance.draw_effects(cell_means - beta[:, present], rng)  # (q, n, W)
            is_own = own_cells[pattern.members[0]]
            average_columns = laws.scales.effects[:, :, is_own].mean(axis=2)  # (q, P, W)
            drawn = np.einsum("qnw,qpw->wnp", latents, average_columns)
            of_subjects[:, pattern.members] = drawn
    return effects
