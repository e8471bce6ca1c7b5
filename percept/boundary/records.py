"""Realistic performance boundaries as records."""

from __future__ import annotations

import dataclasses
import html
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Shape = Literal["corner", "envelope", "pointwise"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Boundary:
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
        "envelope": exact smallest and largest magnitude over the region. "pointwise": quantiles of
        draws at each omega.
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
    departure : float or None
        Where the frequencies were chosen for the curves: bound of the relative distance of straight lines
        between them, in log-log, from every curve (a pointwise one counts as the smooth band it runs along).
        None for frequencies asked for.
    error, largest_error : float or None
        Of a pointwise boundary: typical (root mean square over log omega) and largest Monte Carlo error of
        its curves, as a share of half the band's width, in logarithms. It compares two halves of the draws.
        None for a boundary around a region, and without width.
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
    departure: float | None = None
    error: float | None = None
    largest_error: float | None = None

    @property
    def points(self) -> int:
        """How many frequencies the curves took."""
        return self.omega.size

    @property
    def band(self) -> Array:
        """Upper minus lower, N·s/m; negative where corner curves have crossed."""
        return self.upper - self.lower

    def _repr_html_(self) -> str:
        what = f"{self.method} {self.shape} boundary of {self.environment}, kind {self.kind}"
        return f"<p>{html.escape(what)}: {self.points} frequencies, level {self.level:g}</p>"
