"""Ellipses of stiffness and damping together, and Hotelling's among them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError
from percept.html import NotebookRecord
from percept.inference.classical.moments import check_option, mean_and_sd, sample, tail_of
from percept.inference.record import Family, Method

Array = NDArray[np.float64]

#: 1 − r² below which rounding of the data explains what is left.
_ON_A_LINE = 1e-13


@dataclass(frozen=True, kw_only=True, eq=False)
class EllipseRegion(NotebookRecord):
    """An ellipse of stiffness and damping, on the scale of its family.

    Points x with (x − centre)ᵀ shape⁻¹ (x − centre) ≤ radius². Under ``"lognormal"`` centre and
    shape refer to natural logarithms, and the region is a closed curve that is no ellipse.
    """

    kind: Literal["mean", "user"]
    method: Method
    family: Family
    level: float  # At which stiffness and damping hold together
    centre: Array  # (2,) Stiffness, damping: N/m, N·s/m, or their logarithms
    shape: Array  # (2, 2) Covariance in the same order
    radius: float  # Mahalanobis distance of the curve from the centre
    n: int  # Users
    joint: Literal["hotelling"] = "hotelling"

    @property
    def sd(self) -> Array:
        """SDs of stiffness and damping, shape (2,), on the family's scale."""
        return np.sqrt(np.diagonal(self.shape))

    def distance(self, stiffness: ArrayLike, damping: ArrayLike) -> Array:
        """Mahalanobis distance from the centre of points in N/m and N·s/m.

        Infinite where the family takes logarithms and a value has none.
        """
        u = self._standard(stiffness, 0)
        v = self._standard(damping, 1)
        r = self.shape[0, 1] / self.sd[0] / self.sd[1]
        unexplained = (1.0 - r) * (1.0 + r)
        with np.errstate(invalid="ignore"):
            squared = (u - r * v) ** 2 / unexplained + v**2
        return np.where(np.isfinite(u) & np.isfinite(v), np.sqrt(squared), np.inf)

    def _standard(self, values: ArrayLike, parameter: int) -> Array:
        """Values of one parameter in its SDs from the centre, on the family's scale."""
        x = np.asarray(values, dtype=float)
        if self.family == "lognormal":
            x = np.log(x, out=np.full_like(x, -np.inf), where=x > 0.0)
        return (x - self.centre[parameter]) / self.sd[parameter]


def ellipse_region(
    stiffness: ArrayLike,
    damping: ArrayLike,
    *,
    kind: Literal["mean", "user"],
    level: float = 0.99,
    family: Family = "normal",
) -> EllipseRegion:
    """Work out Hotelling's ellipse, which holds stiffness and damping together at exactly `level`.

    Each row holds the values of the same subjects in the same order. With two parameters the F
    quantile is elementary: radius² = (n − 1)(α^{−2/(n−2)} − 1)·q, with α = 1 − level, and q = 1/n
    for the mean, 1 + 1/n for the next user.

    Parameters
    ----------
    stiffness, damping : array_like
        One value per subject, N/m and N·s/m, shape (n,).
    kind : {"mean", "user"}
        Whether it holds the average user or the next one.
    level : float
        Confidence; 0 to 1, exclusive.
    family : {"normal", "lognormal"}
        Distribution between users.

    Returns
    -------
    EllipseRegion

    Raises
    ------
    UsageError
        Values that are not finite or not equally many, an unknown option or level.
    RefusalError
        Fewer than 3 subjects, no scatter, subjects on a line; zero or negative values under
        ``"lognormal"``.
    """
    check_option("kind", kind, ("mean", "user"))
    check_option("family", family, ("normal", "lognormal"))
    alpha = tail_of(level)
    log = family == "lognormal"
    k = sample(stiffness, positive=log, least=3)
    b = sample(damping, positive=log, least=3)
    if k.ndim != 1 or k.shape != b.shape:
        raise UsageError(
            f"One stiffness and one damping per subject are needed: {k.shape}, {b.shape}."
        )
    pair = np.stack([k, b])
    if log:
        pair = np.log(pair)
    n = k.size
    centre, sd = mean_and_sd(pair)
    if (sd == 0.0).any():
        raise RefusalError(
            "All subjects gave the same stiffness, or damping: with no scatter there is no ellipse."
        )
    # Deviations from an element of the sample first, so that an offset does not round them.
    shifted = pair - pair[:, :1]
    shifted_mean, _ = mean_and_sd(shifted)
    standard = (shifted - shifted_mean[:, None]) / sd[:, None]
    r = math.fsum(standard[0] * standard[1]) / (n - 1)
    if 1.0 - r * r < _ON_A_LINE:
        raise RefusalError(
            "Stiffness and damping of the subjects lie on a line: there is no ellipse."
        )
    correlation = np.array([[1.0, r], [r, 1.0]])
    stretch = (n - 1) * math.expm1(-2.0 * math.log(alpha) / (n - 2))
    spread = 1.0 / n if kind == "mean" else 1.0 + 1.0 / n
    return EllipseRegion(
        kind=kind,
        method="classical",
        family=family,
        level=level,
        centre=centre,
        shape=np.outer(sd, sd) * correlation,
        radius=math.sqrt(stretch * spread),
        n=n,
    )
