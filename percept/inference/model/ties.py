"""How far the rough log SDs of stiffness and damping go together: their tie.

Samples of pairs with the correlation rho have log SDs with a correlation of rho². The tie is that
square, with rho taken two standard errors nearer zero. It shapes coordinates alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.cell_scatter import centred
from percept.inference.model.statistics import Statistics

__all__ = ["tie_between", "tie_trial"]

Array = NDArray[np.float64]

#: Largest correlation of k and b, since atanh(1) is infinite. SDs whose ratio is known to a
#: fiftieth of their own error, √(1 - 0.9999⁴), leave nothing to gain beyond.
_LARGEST_CORRELATION = 0.9999
#: Standard errors by which the correlation is drawn towards zero: two quantities whose correlation
#: is chance, at the usual 95 %, then have separate coordinates.
_STANDARD_ERRORS = 2.0


def tie_between(statistics: Statistics, *, subject_effect: bool) -> float:
    """Tie of the SDs between subjects, by departures of subjects' cell means.

    Subjects' means over their cells are taken away where subjects have an effect of their own.
    """
    means = statistics.cell_means
    finite = np.isfinite(means)
    complete = np.asarray(finite.all(axis=1, keepdims=True))
    departures = means
    if subject_effect:
        departures = centred(departures, complete, 2)
    departures = centred(departures, complete, 0)
    # Each environment weighs by its degrees of freedom, whatever its spread.
    squares = np.square(departures).sum(axis=0)
    subjects = complete.sum(axis=0)
    variance = squares / np.maximum(subjects - 1.0, 1.0)
    sd = np.sqrt(variance)
    df = statistics.df.min(axis=0)
    by_quantity = np.moveaxis(departures, 1, 0)
    return _tie(by_quantity, sd[:, None], df.sum())


def tie_trial(statistics: Statistics) -> float:
    """Tie of the SDs between trials, by the rows of their scatter."""
    rows = statistics.trial_rows
    df = statistics.trial_df
    squares = np.square(rows).sum(axis=1, keepdims=True)
    variance = squares / np.maximum(df, 1.0)
    sd = np.sqrt(variance)
    return _tie(rows, sd, df.sum())


def _tie(departures: Array, sd: Array, df: float) -> float:
    """Tie of departures (P, ...), in units of their SD, with so many degrees of freedom.

    A single quantity has no correlation: its tie is zero.
    """
    if len(departures) < 2:
        return 0.0
    divisor = np.where(sd > 0, sd, 1.0)
    standardised = departures / divisor
    first = standardised[0].ravel()
    second = standardised[1].ravel()
    product = (first @ first) * (second @ second)
    # The Fisher transform atanh(rho) has the standard error 1/√(df - 3).
    if df <= 3.0 or product == 0.0:
        return 0.0
    correlation = abs(first @ second) / math.sqrt(product)
    transform = math.atanh(min(correlation, _LARGEST_CORRELATION))
    standard_error = 1.0 / math.sqrt(df - 3.0)
    nearer_zero = transform - _STANDARD_ERRORS * standard_error
    rho = math.tanh(max(nearer_zero, 0.0))
    return rho * rho
