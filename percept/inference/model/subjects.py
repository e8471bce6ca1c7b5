"""What a model says of its subjects: the laws of their cell means, and draws of their effects."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import Block
from percept.inference.model.gaussian import SubjectCovariance
from percept.inference.model.model import LinearModel

__all__ = [
    "SubjectLaws",
    "cells_of_subjects",
    "draw_subject_effects",
    "subject_laws",
    "trial_groups",
]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectLaws:
    """What W sets of scales say of subjects' cell means: P quantities in C cells."""

    mean: Array  # (P, C, W) Mean of the locations
    columns: Array  # (K, P, C, W) Columns whose products sum to the locations' covariance
    effects: Array  # (q, P, C, W) What a unit of each of a subject's effects adds
    noise: tuple[Block, ...]  # (E, W) By pattern: the rest of the variance of cell means
    covariances: tuple[SubjectCovariance, ...]  # By pattern: of the cell means about the locations
    trial: Block | None  # Covariance between trials, one for each group of trials


def trial_groups(model: LinearModel) -> Indices:
    """Look up the group of trials of every subject in every cell.

    Parameters
    ----------
    model : LinearModel
        Of N subjects in C cells.

    Returns
    -------
    ndarray of int
        Shape (N, C): the cell itself where subjects are pooled; else zero for a subject without
        trials there.
    """
    return model.rows.trial_groups[:, model.rows.pattern_of_subject].T


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
    belongs = np.ones((len(model.statistics.subjects), model.rows.cells), dtype=bool)
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
    scales = model.linear_scales(points).cells
    observed = model.with_resolution(scales)
    law = model.law(points)
    of_kinds = model.rows.noise(observed)
    noise = []
    covariances = []
    for g, pattern in enumerate(model.statistics.patterns):
        of_pattern = of_kinds[model.rows.kind[model.rows.pattern == g]]  # (E, W)
        noise.append(of_pattern)
        effects = scales.effects[:, :, pattern.environments]
        covariances.append(SubjectCovariance(of_pattern, effects))
    by_cell = (*model.design.cells.x.shape, len(points))  # (P, C, W)
    mean = law.mean[:, : len(model.cells)].T
    columns = law.columns(model.cell_rows).transpose(2, 1, 0)
    return SubjectLaws(
        mean=mean.reshape(by_cell),
        columns=columns.reshape(-1, *by_cell),
        effects=scales.effects,
        noise=tuple(noise),
        covariances=tuple(covariances),
        trial=observed.trial,
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
    effects = []
    first = 0
    for part in model.passes(points):
        last = first + len(part)
        effects.append(_effects_of_pass(model, part, locations[first:last], rng))
        first = last
    return np.concatenate(effects)


def _effects_of_pass(
    model: LinearModel,
    points: Array,
    locations: Array,
    rng: np.random.Generator,
) -> Array:
    """Effects (W, N, P) at the points of one pass."""
    laws = subject_laws(model, points)
    cell_means = model.statistics.cell_means
    beta = locations.T.reshape(laws.mean.shape)  # (P, C, W)
    effects = np.empty((len(locations), len(cell_means), len(beta)))
    cells_of_subject = cells_of_subjects(model)
    patterns = zip(model.statistics.patterns, laws.covariances, strict=True)
    for pattern, covariance in patterns:
        present = pattern.environments
        residual = cell_means[pattern.members][:, :, present, None] - beta[:, present]
        is_own = cells_of_subject[pattern.members[0]]
        average_columns = laws.effects[:, :, is_own].mean(axis=2)  # (q, P, W)
        latents = covariance.draw_effects(residual, rng)  # (q, n, W)
        effects[:, pattern.members] = np.einsum("qnw,qpw->wnp", latents, average_columns)
    return effects
