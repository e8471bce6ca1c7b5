"""Draws of the subjects' effects, given scales, locations and data.

With the locations beta known, a subject's cell means less beta are u + noise. Their weighted mean m
over environments is N(u, A), with A the inverse of the summed precisions. Before any data u is
N(0, S), with S the covariance `shared`. Let u0 be a draw of u before any data and e0 one of N(0,
A). Then

    u0 + S (S + A)⁻¹ (m - u0 - e0)

has u's law given m. Nothing is subtracted from a variance.

Shapes: P quantities, C cells (without factors they are the J environments), E of them in a pattern
of n subjects, N subjects in all, q effects of a subject, W draws of the scales.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector
from percept.inference.hierarchy.laws import SubjectLaws
from percept.inference.hierarchy.shared_covariance import weighted_mean
from percept.inference.hierarchy.statistics import Statistics
from percept.inference.hierarchy.subject_covariance import SubjectCovariance

__all__ = ["draw_effects_of", "draw_subject_effects"]

Array = NDArray[np.float64]


def draw_subject_effects(
    statistics: Statistics,
    shared: Block,
    cell_noise: Sequence[Block],
    locations: Array,
    rng: np.random.Generator,
) -> Array:
    """Draw what every subject adds to all environments.

    Parameters
    ----------
    statistics : Statistics
        Of the responses.
    shared : Block
        Covariance of the subject effect, entries (W,).
    cell_noise : sequence of Block
        Covariance of a cell mean about the effect, by pattern, entries (E, W).
    locations : ndarray
        Locations drawn at these scales, on the response scale, shape (W, P J), quantity by
        quantity.
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    ndarray
        On the response scale, shape (W, N, P).
    """
    cell_means = statistics.cell_means
    subjects, size, environments = cell_means.shape
    beta = locations.T.reshape(size, environments, -1)
    effects = np.empty((len(locations), subjects, size))
    for pattern, noise in zip(statistics.patterns, cell_noise, strict=True):
        present = pattern.environments
        pattern_means = cell_means[pattern.members][:, :, present]  # (n, P, E)
        by_quantity = pattern_means.swapaxes(0, 1)[..., None]
        residual = by_quantity - beta[:, None, present]  # (P, n, E, W)
        pattern_effects = _draw_effects(noise, shared, tuple(residual), rng)
        effects[:, pattern.members] = pattern_effects.transpose(2, 1, 0)
    return effects


def _draw_effects(
    cell_noise: Block,
    shared: Block,
    residual: Vector,
    rng: np.random.Generator,
) -> Array:
    """Draw effects (P, n, W) from residuals (n, E, W) per quantity, of n subjects."""
    precisions = cell_noise.inverse()
    precision = precisions.total()
    noise_of_mean = precision.inverse()  # A
    mean = np.stack(weighted_mean(precisions, precision, residual))
    subjects_and_draws = mean.shape[1:]
    prior_draw = _draw_normals(shared, subjects_and_draws, rng)
    noise_draw = _draw_normals(noise_of_mean, subjects_and_draws, rng)
    gap = mean - prior_draw - noise_draw
    total = shared + noise_of_mean
    weighted = total.inverse().apply(tuple(gap))
    shift = shared.apply(weighted)
    return prior_draw + np.stack(shift)


def _draw_normals(covariance: Block, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Draw vectors (P, n, W) of a covariance (W,), for the shape (n, W)."""
    columns = covariance.factor_columns()
    vectors = np.zeros((len(columns), *shape))
    for column in columns:
        by_quantity = np.stack(column)[:, None]
        vectors += by_quantity * rng.standard_normal(shape)
    return vectors


def draw_effects_of(
    laws: SubjectLaws,
    statistics: Statistics,
    locations: Array,
    rng: np.random.Generator,
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
    cell_means = statistics.cell_means
    beta = locations.T.reshape(laws.mean.shape)  # (P, C, W)
    average_columns = laws.effects.mean(axis=2)  # (q, P, W)
    effects = np.empty((len(locations), len(cell_means), len(beta)))
    for pattern, noise in zip(statistics.patterns, laws.noise, strict=True):
        present = pattern.environments
        covariance = SubjectCovariance(noise, laws.effects[:, :, present])
        pattern_means = cell_means[pattern.members][:, :, present, None]
        residual = pattern_means - beta[:, present]  # (n, P, E, W)
        latents = covariance.draw_effects(residual, rng)  # (q, n, W)
        effects[:, pattern.members] = np.einsum("qnw,qpw->wnp", latents, average_columns)
    return effects
