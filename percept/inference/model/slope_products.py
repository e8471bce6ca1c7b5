"""What the data say of the slopes of covariates: products of the slopes with one another and data.

A covariate shifts the response of quantity p by its slope for p times its value. There are M
covariates and P quantities, so M P slopes, covariate by covariate. Three independent parts of the
data hold information on them, and their products are summed:

    the mean cell means of each pattern       by D⁻¹
    subjects about the mean of their pattern  by V⁻¹ = (D + ZZ')⁻¹
    trials about the mean of their cell       by the inverse covariance between trials

For the first part subjects' effects count as known: the normal equations hold them as unknowns. D
is the covariance of a subject's cell means about the effects, and Z the columns of these effects. T
are the groups of trials.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import Block, precision_entries
from percept.inference.model.cell_problem import CellProblem, PatternScatter
from percept.inference.model.subject_covariance import SubjectCovariance
from percept.inference.model.subject_equations import SubjectEquations
from percept.inference.model.trial_scatter import TrialScatter

__all__ = ["SlopeProducts", "slope_products"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class SlopeProducts:
    """Products of slopes at W sets of scales, in the slopes' own unit: no prior enters."""

    by_slopes: Array  # (M P, M P, W) With one another: their information
    by_data: Array  # (M P, W) With the data

    @classmethod
    def in_one_row(cls, by_slopes: Array, by_data: Array) -> SlopeProducts:
        """Slopes in one row, from products (M, P, M, P, W) and (M, P, W)."""
        covariates, size, width = by_data.shape
        slopes = covariates * size
        return cls(
            by_slopes=by_slopes.reshape(slopes, slopes, width),
            by_data=by_data.reshape(slopes, width),
        )

    def plus(self, other: SlopeProducts) -> SlopeProducts:
        """Sum of two independent sources of information."""
        return SlopeProducts(
            by_slopes=self.by_slopes + other.by_slopes,
            by_data=self.by_data + other.by_data,
        )


def slope_products(
    problem: CellProblem,
    subject: SubjectEquations,
    trial: Block | None,
) -> SlopeProducts:
    """Sum the products of all three parts of the data.

    Parameters
    ----------
    problem : CellProblem
        Means, scatter and covariates of the study.
    subject : SubjectEquations
        Noise and effects of one subject of each pattern.
    trial : Block, optional
        Covariance between trials, entries (T, W).

    Returns
    -------
    SlopeProducts
    """
    products = _of_means(problem, precision_entries(subject.precision))
    if trial is not None:
        products = products.plus(_of_trials(problem.trial_scatter, trial))
    covariances = subject.covariances()
    for scatter, covariance in zip(problem.scatter, covariances, strict=True):
        precision = subject.precision[scatter.cells, scatter.pattern]
        of_subjects = _of_subjects(scatter, covariance, precision)
        products = products.plus(of_subjects)
    return products


def _of_means(problem: CellProblem, precision: Array) -> SlopeProducts:
    """Products of the patterns' mean cell means, by the precision (P, P, C, G, W) of a subject."""
    values = problem.covariate_mean
    over_subjects = values * problem.subjects
    by_slopes = np.einsum("pqcgw,mcg,ncg->mpnqw", precision, values, over_subjects)
    by_data = np.einsum("pqcgw,mcg,qcg->mpw", precision, over_subjects, problem.mean)
    return SlopeProducts.in_one_row(by_slopes, by_data)


def _of_trials(scatter: TrialScatter, trial: Block) -> SlopeProducts:
    """Products of trials about the mean of their cell."""
    values = scatter.covariate_rows
    precision = precision_entries(trial.inverse())  # (P, P, T, W)
    squares = np.einsum("lmt,lnt->mnt", values, values)
    responses = np.einsum("lmt,lqt->mqt", values, scatter.response_rows)
    by_slopes = np.einsum("mnt,pqtw->mpnqw", squares, precision)
    by_data = np.einsum("mqt,pqtw->mpw", responses, precision)
    return SlopeProducts.in_one_row(by_slopes, by_data)


def _of_subjects(
    scatter: PatternScatter,
    covariance: SubjectCovariance,
    precision: Block,
) -> SlopeProducts:
    """Products of the n rows of subjects about the mean of their pattern, of E cells.

    With LL' = I + Z'H the inverse is V⁻¹ = D⁻¹ - (L⁻¹H')'(L⁻¹H'). `precision` is D⁻¹.
    """
    data = scatter.rows[None]
    rows = np.concatenate([scatter.slopes, data])  # (M P + 1, n, P, E)
    count, subjects, size, cells = rows.shape
    entries = precision_entries(precision)  # (P, P, E, W)
    width = entries.shape[-1]
    # Both products of matrices are faster than one sum over subjects, quantities and cells.
    squares = np.einsum("anpe,bnqe->abpqe", rows, rows)
    flat_squares = squares.reshape(count * count, -1)
    flat_entries = entries.reshape(-1, width)
    by_noise = flat_squares @ flat_entries
    by_noise = by_noise.reshape(count, count, width)
    every_row = rows.reshape(count * subjects, size, cells)
    whitened = covariance.whitened_effects(every_row)  # (q, (M P + 1) n, W)
    whitened = whitened.reshape(len(whitened), count, subjects, width)
    explained_by_effects = np.einsum("qanw,qbnw->abw", whitened, whitened)
    products = by_noise - explained_by_effects
    slopes = products[:-1]
    return SlopeProducts(by_slopes=slopes[:, :-1], by_data=slopes[:, -1])
