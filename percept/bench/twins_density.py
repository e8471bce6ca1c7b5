"""The hierarchical model's log density written plainly: the same matrices in 120 digits and in doubles.

Every subject sees every environment equally often. Two parameters; a subject's values are stacked by
environment, then trial, then parameter.
"""

from __future__ import annotations

import dataclasses
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
# mpmath numbers and matrices have no types.
Number: TypeAlias = Any

DIGITS = 120
_ALPHA_SD, _GAMMA_SD = 1.0, 0.25


@dataclasses.dataclass(frozen=True)
class Levels:
    """SDs of the model's levels, equal for both parameters and all environments, on the response scale."""

    between: float
    shared: float
    trial: float
    tau: float
    rest: float  # 1 - rho, rho the correlation of both parameters at every level


def exact(response: Array, x: Array, levels: Levels) -> Number:
    """Evaluate the log density in `DIGITS` digits."""
    import mpmath

    with mpmath.workdps(DIGITS):
        subjects = len(response)
        covariance, design = (
            mpmath.matrix(rows) for rows in _model(response.shape[1:3], x, levels, mpmath.mpf)
        )
        columns = [[mpmath.mpf(value) for value in row] for row in response.reshape(subjects, -1).T.tolist()]
        size = len(columns)
        total = mpmath.matrix([mpmath.fsum(column) for column in columns])
        squares = mpmath.matrix(size, size)
        for i in range(size):
            for j in range(i + 1):
                squares[i, j] = squares[j, i] = mpmath.fdot(columns[i], columns[j])
        inverse = covariance**-1
        pull = design.T * inverse
        inner = mpmath.eye(design.cols) + subjects * pull * design
        right = pull * total
        distance = mpmath.fsum(inverse[i, j] * squares[i, j] for i in range(size) for j in range(size))
        distance -= (right.T * inner**-1 * right)[0]
        log_determinant = subjects * mpmath.log(mpmath.det(covariance)) + mpmath.log(mpmath.det(inner))
        return -(distance + log_determinant + subjects * size * mpmath.log(2 * mpmath.pi)) / 2


def woodbury(response: Array, x: Array, levels: Levels) -> float:
    """Evaluate the same formula in doubles; NaN where a matrix is singular."""
    values = response.reshape(len(response), -1)
    model = _model(response.shape[1:3], x, levels, float)
    covariance: Array = np.array(model[0])
    design: Array = np.array(model[1])
    subjects = len(values)
    try:
        with np.errstate(all="ignore"):
            pull = design.T @ np.linalg.inv(covariance)
            inner = np.eye(design.shape[1]) + subjects * pull @ design
            right = pull @ values.sum(axis=0)
            distance = np.vdot(np.linalg.inv(covariance), values.T @ values)
            distance -= right @ np.linalg.solve(inner, right)
            log_determinant = subjects * np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(inner)[1]
    except np.linalg.LinAlgError:
        return float("nan")
    return float(-0.5 * (distance + log_determinant + values.size * np.log(2.0 * np.pi)))


def _model(
    shape: tuple[int, ...], x: Array, levels: Levels, number: type[Any]
) -> tuple[list[list[Number]], list[list[Number]]]:
    """Covariance of one subject's values about the locations, and the columns of the locations' factor."""
    environments, trials = shape
    rho = number(1) - number(levels.rest)
    between, shared, trial, tau = (
        number(sd) for sd in (levels.between, levels.shared, levels.trial, levels.tau)
    )
    places = [(j, r, p) for j in range(environments) for r in range(trials) for p in range(2)]
    covariance = [
        [
            (number(1) if p == q else rho)
            * (shared**2 + (j == h) * between**2 + ((j, r) == (h, s)) * trial**2)
            for h, s, q in places
        ]
        for j, r, p in places
    ]
    zero = number(0)
    design = []
    for j, _, p in places:
        row = [number(_ALPHA_SD) if p == q else zero for q in range(2)]
        row += [number(_GAMMA_SD) * number(float(x[p, j])) if p == q else zero for q in range(2)]
        row += [tau if (j, p) == (h, q) else zero for h in range(environments) for q in range(2)]
        design.append(row)
    return covariance, design
