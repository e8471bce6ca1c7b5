"""Draws of the subjects' effects, given scales, locations and data.

With the locations beta known, a subject's cell means less beta are u + noise: their weighted mean m
over environments is N(u, A), A the inverse of the summed precisions, and u is N(0, Sigma_u) before.
A draw u0 of u and e0 of the noise then give u0 + Sigma_u (Sigma_u + A)⁻¹ (m - u0 - e0), which has
u's law given m. Nothing is subtracted from a variance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector, weighted_mean
from percept.inference.hierarchy.laws import SubjectLaws
from percept.inference.hierarchy.statistics import Statistics
from percept.inference.hierarchy.subject_covariance import SubjectCovariance

__all__ = ["draw_effects_of", "draw_subject_effects"]

Array = NDArray[np.float64]


def draw_subject_effects(
    statistics: Statistics,
    shared: Block,
    blocks: Sequence[Block],
    locations: Array,
    rng: np.random.Generator,
) -> Array:
    """Draw what every subject adds to all environments.

    Parameters
    ----------
    statistics : Statistics
        Of the responses.
    shared : Block
        Covariance of the subject effect at S draws, entries (S,).
    blocks : sequence of Block
        Covariance of a cell mean about the effect, by pattern, entries (E, S).
    locations : ndarray
        Locations drawn at these, on the response scale, shape (S, P J), parameter by parameter.
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    ndarray
        On the response scale, shape (S, N, P).
    """
    means = statistics.cell_means
    subjects, parameters, environments = means.shape
    beta = locations.T.reshape(parameters, environments, -1)
    effects = np.empty((len(locations), subjects, parameters))
    for pattern, cell in zip(statistics.patterns, blocks, strict=True):
        present = pattern.environments
        own = means[pattern.members][:, :, present]
        by_parameter = own.transpose(1, 0, 2)[..., None]
        residual = by_parameter - beta[:, None, present]
        drawn = _drawn(cell, shared, tuple(residual), rng)
        effects[:, pattern.members] = np.stack(drawn).transpose(2, 1, 0)
    return effects


def draw_effects_of(
    laws: SubjectLaws, statistics: Statistics, locations: Array, rng: np.random.Generator
) -> Array:
    """Draw what every subject adds under a linear design, averaged over all C cells.

    Parameters
    ----------
    laws : SubjectLaws
        At W sets of scales; the columns of effects differ between cells.
    statistics : Statistics
        Of the responses.
    locations : ndarray
        Locations drawn at these scales, on the response scale, shape (W, P C).
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    ndarray
        On the response scale, shape (W, N, P).
    """
    means = statistics.cell_means
    by_cell = locations.T.reshape(laws.mean.shape)  # (P, C, W)
    average_effects = laws.effects.mean(axis=2)  # (q, P, W)
    drawn = np.empty((len(locations), len(means), len(by_cell)))
    for pattern, noise in zip(statistics.patterns, laws.noise, strict=True):
        present = pattern.environments
        covariance = SubjectCovariance(noise, laws.effects[:, :, present])
        observed = means[pattern.members][:, :, present, None]
        latents = covariance.draw_effects(observed - by_cell[:, present], rng)
        drawn[:, pattern.members] = np.einsum("qnw,qpw->wnp", latents, average_effects)
    return drawn


def _drawn(cell: Block, shared: Block, residual: Vector, rng: np.random.Generator) -> Vector:
    """Draw effects (n, W) per parameter from residuals (n, E, W) of n subjects."""
    precisions = cell.inverse()
    precision = precisions.total()
    noise = precision.inverse()
    mean = weighted_mean(precisions, precision, residual)
    prior_draw = _normal(shared, mean[0].shape, rng)
    noise_draw = _normal(noise, mean[0].shape, rng)
    gap = np.stack(mean) - prior_draw - noise_draw
    outer = shared + noise
    weighted = outer.inverse().apply(tuple(gap))
    shift = shared.apply(weighted)
    return tuple(prior_draw + np.stack(shift))


def _normal(covariance: Block, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Draw vectors of a covariance, per parameter of the shape (n, W)."""
    columns = covariance.factor_columns()
    drawn = np.zeros((len(columns), *shape))
    for column in columns:
        drawn += np.stack(column)[:, None] * rng.standard_normal(shape)
    return drawn
