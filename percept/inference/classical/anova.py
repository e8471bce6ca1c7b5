"""Analysis of variance of repeated measures: factors within subjects, and groups of subjects.

Every effect within subjects is a set of orthonormal contrasts. Each subject has one value of each
contrast, so the effect is a mean of subjects' values, and its error is their scatter in the groups.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from percept.errors import RefusalError

__all__ = ["Effect", "anova"]

Array = NDArray[np.float64]

#: Squared scatter over the sum of the squared deviations from the common mean, below which the
#: scatter is rounding alone.
_NO_SCATTER = 1e-26
#: The same over the sum of the squared values: each is rounded by up to 1.1e-16 of itself.
_NO_SCATTER_OF_VALUES = 1e-31


@dataclass(frozen=True)
class Effect:
    """The test of one effect, a main effect or an interaction."""

    factors: tuple[str, ...]  # Whose levels differ: one of a main effect
    f: float
    df: float  # Of the effect, uncorrected
    df_error: float  # Of its error, uncorrected
    p_value: float  # Uncorrected
    epsilon: float  # Greenhouse and Geisser's; 1 with one contrast, and between subjects
    df_corrected: float  # Times `epsilon`, as is that of the error
    df_error_corrected: float
    p_corrected: float
    partial_eta2: float  # Of the sums of squares of the effect and its error
    generalised_eta2: float  # Share of the sums of squares of the effect and of all errors


@dataclass(frozen=True)
class _Squares:
    """Sums of squares of one effect."""

    factors: tuple[str, ...]
    effect: float
    error: float
    df: int
    df_error: int
    epsilon: float


def anova(
    values: Array,
    within: Sequence[str],
    *,
    group: NDArray[np.intp] | None = None,
    between: str = "group",
) -> tuple[Effect, ...]:
    """Test all main effects and interactions of factors within subjects, and of groups.

    Parameters
    ----------
    values : ndarray, shape (n, levels of the first factor, levels of the second, ...)
        Each subject's value in each cell, in any unit; no value is missing.
    within : sequence of str
        Names of the factors within subjects, in the order of the axes.
    group : ndarray of int, shape (n,), optional
        Number of each subject's group, from 0. Groups may differ in size: effects within subjects
        then give all groups the same weight (sums of squares of type III).
    between : str
        Name of the groups' factor.

    Returns
    -------
    tuple of Effect
        Main effects first. With groups, each effect is followed by its interaction with them.

    Raises
    ------
    RefusalError
        A group of fewer than two subjects, a factor of fewer than two levels, or an effect without
        scatter between subjects.

    Notes
    -----
    Epsilon is tr(S)² / (q tr(S²)) with the pooled covariance S of the q contrasts: S. Greenhouse
    and S. Geisser, Psychometrika 24 (1959) 95. Generalised eta squared follows S. Olejnik and
    J. Algina, Psychological Methods 8 (2003) 434, with all factors taken as manipulated.
    """
    if group is None:
        group = np.zeros(len(values), dtype=np.intp)
    sizes = np.bincount(group)
    if sizes.min() < 2:
        raise RefusalError("an analysis of variance needs two subjects in every group.")
    for name, levels in zip(within, values.shape[1:], strict=True):
        if levels < 2:
            raise RefusalError(f"an analysis of variance needs two levels of {name}.")
    # A common offset drops out of every contrast; without it they keep their digits.
    centred = values - values.mean()
    squares: list[_Squares] = []
    error_of_all = 0.0
    for axes in _effects(len(within)):
        scores = _scores(centred, axes)
        names = tuple(within[axis] for axis in axes)
        error, rows = _squares(scores, group, sizes, names, between)
        error_of_all += error
        squares += rows
    least_of_deviations = _NO_SCATTER * float(np.sum(centred**2))
    least_of_values = _NO_SCATTER_OF_VALUES * float(np.sum(values**2))
    least = max(least_of_deviations, least_of_values)
    for row in squares:
        if row.error <= least:
            raise RefusalError(
                f"all subjects have the same effect of {' and '.join(row.factors)}: with no scatter"
                " there is no F."
            )
    return tuple(_tested(row, error_of_all) for row in squares)


def _effects(factors: int) -> Iterator[tuple[int, ...]]:
    """Yield the axes of every effect: subjects' means, main effects, interactions."""
    for order in range(factors + 1):
        yield from itertools.combinations(range(factors), order)


def _scores(values: Array, axes: Sequence[int]) -> Array:
    """Subjects' values of the orthonormal contrasts of an effect, (n, q)."""
    scores = values
    for axis in range(values.ndim - 1):
        levels = values.shape[1 + axis]
        rows = np.full((1, levels), levels**-0.5)
        if axis in axes:
            rows = linalg.helmert(levels)
        # The axis that is summed over goes, and the contrasts come last: all axes turn once.
        scores = np.tensordot(scores, rows, axes=(1, 1))
    return scores.reshape(len(values), -1)


def _means(scores: Array, group: NDArray[np.intp], sizes: NDArray[np.intp]) -> Array:
    """Means of the groups, (G, q)."""
    sums = np.zeros((len(sizes), scores.shape[1]))
    np.add.at(sums, group, scores)
    return np.asarray(sums / sizes[:, None])


def _squares(
    scores: Array,
    group: NDArray[np.intp],
    sizes: NDArray[np.intp],
    names: tuple[str, ...],
    between: str,
) -> tuple[float, list[_Squares]]:
    """Split the squares of an effect: its error, and the effect itself and with groups.

    Without factors, the scores are subjects' means: the only effect is that of the groups.
    """
    contrasts = scores.shape[1]
    groups = len(sizes)
    df_subjects = len(scores) - groups
    means = _means(scores, group, sizes)
    deviations = scores - means[group]
    # The covariance times its degrees of freedom, which cancel; of more contrasts than subjects the
    # smaller product, which has the same traces of itself and of its square.
    few = deviations.T if contrasts <= len(scores) else deviations
    covariance = few @ few.T
    error = float(np.trace(covariance))
    epsilon = 1.0
    if contrasts > 1 and error > 0.0:
        epsilon = error**2 / (contrasts * float(np.sum(covariance**2)))
    df_error = contrasts * df_subjects
    rows = []
    if names:
        # The plain mean of the groups' means; of one group it is the mean of all subjects.
        mean = means.mean(axis=0)
        weight = groups**2 / float(np.sum(1.0 / sizes))
        effect = weight * float(mean @ mean)
        rows.append(_Squares(names, effect, error, contrasts, df_error, epsilon))
    if groups > 1:
        apart = means - scores.mean(axis=0)
        effect = float(sizes @ np.sum(apart**2, axis=1))
        df = contrasts * (groups - 1)
        rows.append(_Squares((between, *names), effect, error, df, df_error, epsilon))
    return error, rows


def _tested(row: _Squares, error_of_all: float) -> Effect:
    """Make the test of an effect of its sums of squares."""
    f = (row.effect / row.df) / (row.error / row.df_error)
    df_corrected = row.epsilon * row.df
    df_error_corrected = row.epsilon * row.df_error
    return Effect(
        factors=row.factors,
        f=f,
        df=float(row.df),
        df_error=float(row.df_error),
        p_value=float(special.fdtrc(row.df, row.df_error, f)),
        epsilon=row.epsilon,
        df_corrected=df_corrected,
        df_error_corrected=df_error_corrected,
        p_corrected=float(special.fdtrc(df_corrected, df_error_corrected, f)),
        partial_eta2=row.effect / (row.effect + row.error),
        generalised_eta2=row.effect / (row.effect + error_of_all),
    )
