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

_ON_A_LINE = 1e-13  # 1 − r² below this is rounding of the data


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
    centre: NDArray[np.float64]  # (2,) Stiffness, damping: N/m, N·s/m, or their logarithms
    shape: NDArray[np.float64]  # (2, 2) Covariance in the same order
    radius: float  # Mahalanobis distance of the curve from the centre
    n: int  # Users
    joint: Literal["hotelling"] = "hotelling"

    @property
    def sd(self) -> NDArray[np.float64]:
        """SDs of stiffness and damping, shape (2,), on the family's scale."""
        return np.sqrt(np.diagonal(self.shape))

    def distance(self, stiffness: ArrayLike, damping: ArrayLike) -> NDArray[np.float64]:
        """Mahalanobis distance from the centre of points in N/m and N·s/m, infinite without a logarithm."""
        k, b = (np.asarray(values, dtype=float) for values in (stiffness, damping))
        if self.family == "lognormal":
            k, b = (np.log(v, out=np.full_like(v, -np.inf), where=v > 0.0) for v in (k, b))
        u, v = (k - self.centre[0]) / self.sd[0], (b - self.centre[1]) / self.sd[1]
        r = self.shape[0, 1] / self.sd[0] / self.sd[1]
        with np.errstate(invalid="ignore"):
            squared = (u - r * v) ** 2 / ((1.0 - r) * (1.0 + r)) + v**2
        return np.where(np.isfinite(u) & np.isfinite(v), np.sqrt(squared), np.inf)

    def contains(self, stiffness: ArrayLike, damping: ArrayLike) -> NDArray[np.bool_]:
        """Say which points lie inside, the curve included."""
        return self.distance(stiffness, damping) <= self.radius


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
    """
    check_option("kind", kind, ("mean", "user"))
    check_option("family", family, ("normal", "lognormal"))
    alpha = tail_of(level)
    k, b = (sample(x, positive=family == "lognormal", least=3) for x in (stiffness, damping))
    if k.ndim != 1 or k.shape != b.shape:
        raise UsageError(
            f"One stiffness and one damping per subject are needed: {k.shape}, {b.shape}."
        )
    pair = np.stack([k, b])
    if family == "lognormal":
        pair = np.log(pair)
    n = k.size
    centre, sd = mean_and_sd(pair)
    if (sd == 0.0).any():
        raise RefusalError(
            "All subjects gave the same stiffness, or damping: with no scatter there is no ellipse."
        )
    # Deviations from an element of the sample first, so that an offset does not round them.
    shifted = pair - pair[:, :1]
    unit = (shifted - mean_and_sd(shifted)[0][:, None]) / sd[:, None]
    r = math.fsum(unit[0] * unit[1]) / (n - 1)
    if 1.0 - r * r < _ON_A_LINE:
        raise RefusalError(
            "Stiffness and damping of the subjects lie on a line: there is no ellipse."
        )
    stretch = (n - 1) * math.expm1(-2.0 * math.log(alpha) / (n - 2))
    return EllipseRegion(
        kind=kind,
        method="classical",
        family=family,
        level=level,
        centre=centre,
        shape=np.outer(sd, sd) * np.array([[1.0, r], [r, 1.0]]),
        radius=math.sqrt(stretch * (1.0 / n if kind == "mean" else 1.0 + 1.0 / n)),
        n=n,
    )
