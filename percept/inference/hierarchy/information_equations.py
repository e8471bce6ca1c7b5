"""Normal equations of the locations, for studies of several patterns of trial counts.

Given the scales, subject i adds to the information on the locations beta of all environments

    V_i⁻¹ = P_i - P_i 1 T_i 1'P_i

    P_i     precisions P_ij = (Sigma_w,j + Sigma_e,j/r_ij)⁻¹ of the subject's cell means over r_ij
            trials, one block for each environment j; a missing cell has none
    1       puts a subject's effect into each of its environments
    T_i     (Sigma_u⁻¹ + sum_j P_ij)⁻¹, the covariance of the subject's effect given its data

All subjects together have the information L = sum_i V_i⁻¹, and t = sum_i V_i⁻¹ m_i by their cell
means m_i. The locations are beta = tau delta + X'a. The latents (delta, a) are standard normal:
deviations delta of the environments, and coefficients a of the columns X of alpha and gamma. They
have the precision and the right side

    I + [[tau L tau, tau L X'], [X L tau, X L X']]  and  [tau t, X t]

Arrays have axes of P quantities, J environments, G patterns of subjects, K kinds of cells, A
columns X and W draws. There are P J locations, quantity by quantity, and Q = P J + A latents.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block
from percept.inference.hierarchy.information_problem import InformationProblem

__all__ = ["NormalEquations", "normal_equations", "precision_entries"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class NormalEquations:
    """Precision of the latents and its right side."""

    matrix: Array  # (W, Q, Q)
    right: Array  # (W, Q)
    full_diagonal: Array  # (W, Q) What the diagonal would be if subjects' effects were known


def normal_equations(
    problem: InformationProblem,
    tau: Array,
    kinds: Block,
    effect_covariance: Block | None,
) -> NormalEquations:
    """Set up the equations of the latents.

    Parameters
    ----------
    problem : InformationProblem
        Cells, patterns and kinds of cells.
    tau : ndarray
        SD of the deviation of every location, (W, P J).
    kinds : Block
        Covariance of the mean of a cell of each kind, entries (K, W).
    effect_covariance : Block, optional
        T of the subjects of each pattern, entries (G, W); none without subjects' effects.
    """
    environments = problem.environments
    locations = problem.quantities * environments
    width = len(tau)
    entries = precision_entries(kinds.inverse())  # (P, P, K, W)
    subjects_by_kind = problem.in_environment * problem.subjects_of_kind
    #: (P, P, J, W) Sum of P_ij over the subjects.
    known_effects = subjects_by_kind @ entries
    sums = problem.mean_of_kind @ problem.subjects
    sums = sums[..., None]  # (P, K, 1) Of the cell means, over subjects
    information = np.zeros((width, locations, locations))  # L
    if effect_covariance is not None:
        explained = _explained_columns(problem, entries, effect_covariance)
        information = -explained @ explained.transpose(0, 2, 1)
        sums = sums - _effect_sums(problem, entries, effect_covariance)
    environment = np.arange(environments)
    for p in range(problem.quantities):
        row = p * environments + environment
        for q in range(problem.quantities):
            column = q * environments + environment
            information[:, row, column] += known_effects[p, q].T
    # t of the means, which are held about each environment's centre, and of the centres.
    weighted = (entries * sums).sum(axis=1)
    about_centre = problem.in_environment @ weighted
    right = about_centre.reshape(locations, width).T
    right = right + information @ problem.centre.ravel()
    diagonal = np.einsum("ppjw->wpj", known_effects)
    diagonal = diagonal.reshape(width, locations)
    return _of_latents(problem.trend, tau, information, right, diagonal)


def _explained_columns(
    problem: InformationProblem,
    entries: Array,
    effect_covariance: Block,
) -> Array:
    """Columns √N P 1 F with FF' = T, (W, P J, P G).

    Their products are what the effects of the N subjects of a pattern take from the information.
    """
    quantities, _, _, width = entries.shape
    absent = np.zeros((quantities, quantities, 1, width))
    by_kind = np.concatenate([entries, absent], axis=2)
    by_cell = by_kind[:, :, problem.kind_of_cell]  # (P, P, J, G, W)
    root_subjects = np.sqrt(problem.subjects)[:, None]
    columns = []
    for factor_column in effect_covariance.factor_columns():
        products = []
        for q, entry in enumerate(factor_column):
            product = by_cell[:, q] * (root_subjects * entry)
            products.append(product)
        columns.append(sum(products))
    stacked = np.stack(columns)  # (P, P, J, G, W)
    draws_first = stacked.transpose(4, 1, 2, 0, 3)
    locations = quantities * problem.environments
    return draws_first.reshape(width, locations, -1)


def _effect_sums(
    problem: InformationProblem,
    entries: Array,
    effect_covariance: Block,
) -> Array:
    """Best effects T 1'P m at locations of zero, summed over subjects by kind, (P, K, W)."""
    by_pattern = problem.mean_of_kind.transpose(0, 2, 1)
    weighted = (by_pattern @ entries).sum(axis=1)  # (P, G, W)
    effects = effect_covariance.apply(tuple(weighted))
    over_subjects = problem.subjects[:, None] * np.stack(effects)
    return np.asarray(problem.has_kind @ over_subjects)


def _of_latents(
    columns: Array,
    tau: Array,
    information: Array,
    right: Array,
    diagonal: Array,
) -> NormalEquations:
    """Turn L (W, P J, P J) and t (W, P J) into equations of the latents.

    The diagonal (W, P J) is that of L if subjects' effects were known. The columns X are (A, P J).
    """
    width, locations = tau.shape
    latents = locations + len(columns)
    deviations = slice(locations)
    coefficients = slice(locations, latents)
    of_row = tau[:, :, None]
    of_column = tau[:, None, :]
    by_columns = information @ columns.T
    mixed = of_row * by_columns
    matrix = np.empty((width, latents, latents))
    matrix[:, deviations, deviations] = of_row * information * of_column
    matrix[:, deviations, coefficients] = mixed
    matrix[:, coefficients, deviations] = mixed.transpose(0, 2, 1)
    matrix[:, coefficients, coefficients] = columns @ by_columns
    prior = np.einsum("wii->wi", matrix)
    prior += 1.0
    rights = [tau * right, right @ columns.T]
    diagonals = [tau**2 * diagonal, diagonal @ (columns**2).T]
    return NormalEquations(
        matrix=matrix,
        right=np.concatenate(rights, axis=1),
        full_diagonal=1.0 + np.concatenate(diagonals, axis=1),
    )


def precision_entries(precision: Block) -> Array:
    """Entries (P, P, ...) of precisions (...)."""
    second = precision.leading
    slope = precision.slope
    if slope is None:
        return second[None, None]
    cross = second * slope
    first = precision.rest + cross * slope
    rows = [[first, cross], [cross, second]]
    return np.stack(rows)
