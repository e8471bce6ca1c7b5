"""Realistic performance boundaries as records."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from percept.html import NotebookRecord

Array = NDArray[np.float64]
Shape = Literal["corner", "envelope", "pointwise", "simultaneous"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Boundary(NotebookRecord):
    """Lower and upper curve of abs(Z_h) over omega that feel like one environment.

    Attributes
    ----------
    environment : str
        The reference condition.
    kind : str
        What is covered: "mean", "user" or "share".
    method, family, joint : str
        How the region or the draws behind it were made.
    shape : str
        "corner": both lower limits together and both upper together (Eqs 16-17); the curves can cross.
        "envelope": exact smallest and largest magnitude over the region. "pointwise": equal-tailed limits of
        the law of (k, b) at each omega. "simultaneous": limits between which whole curves lie with
        probability `level`; they contain the pointwise ones. Bayesian: pointwise limits at a higher level.
        Classical: those joined with the envelope of Hotelling's ellipse; for normal users at least the level.
    level : float
        Level of the region, or of the curves.
    omega : ndarray, shape (M,)
        rad/s.
    lower, upper : ndarray, shape (M,)
        N·s/m.
    reference : ndarray, shape (M,)
        abs(Z_h) of the reference environment, without coupling, N·s/m.
    coupled : ndarray, shape (M,), or None
        abs(Z_h) of the reference through the virtual coupling (Eq. 11), N·s/m.
    errors : ndarray, shape (2, M), or None
        Monte Carlo standard errors of log lower and log upper, from batches of posterior draws; None where
        nothing is drawn.
    error, largest_error : float or None
        Typical (root mean square over log omega) and largest of `errors`, as a fraction of half the band's
        width in logarithms. None without errors, and without width.
    pointwise_level, pointwise_level_error : float or None
        Of a Bayesian simultaneous boundary: the level of its limits at each omega, and its Monte Carlo error.
    """

    environment: str
    kind: str
    method: str
    family: str
    joint: str
    shape: Shape
    level: float
    omega: Array
    lower: Array
    upper: Array
    reference: Array
    coupled: Array | None = None
    errors: Array | None = None
    error: float | None = None
    largest_error: float | None = None
    pointwise_level: float | None = None
    pointwise_level_error: float | None = None

    @property
    def band(self) -> Array:
        """Upper minus lower, N·s/m; negative where corner curves have crossed."""
        return self.upper - self.lower
