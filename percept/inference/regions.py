"""Regions of stiffness and damping together, with the level at which the two hold together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import UsageError
from percept.inference.covers import percent
from percept.inference.intervals import Family, Interval, Joint, Kind, Method
from percept.notebook import NotebookRecord


@dataclass(frozen=True, kw_only=True)
class RectangleRegion(NotebookRecord):
    """An interval of stiffness times an interval of damping.

    Parameters
    ----------
    stiffness, damping : Interval
        Of one environment: same kind, method, family, level and joint treatment. N/m and N·s/m.
    """

    stiffness: Interval
    damping: Interval

    def __post_init__(self) -> None:
        for name in ("kind", "method", "family", "joint", "level", "share", "confidence"):
            k, b = getattr(self.stiffness, name), getattr(self.damping, name)
            if k != b:
                raise UsageError(f"The intervals of stiffness and damping differ in {name}: {k!r} and {b!r}.")
        for interval in (self.stiffness, self.damping):
            if np.ndim(interval.lower):
                raise UsageError("A region is of one environment: its limits must be single numbers.")

    @property
    def kind(self) -> Kind:
        """What each interval covers."""
        return self.stiffness.kind

    @property
    def method(self) -> Method:
        """How the intervals were worked out."""
        return self.stiffness.method

    @property
    def family(self) -> Family:
        """Distribution between users."""
        return self.stiffness.family

    @property
    def joint(self) -> Joint:
        """How the two intervals were put together."""
        return self.stiffness.joint

    @property
    def joint_level(self) -> tuple[float, float]:
        """Least and most the level of both together can be, whatever their correlation.

        For kind ``"share"`` this is the confidence; `joint_share` says in what.
        """
        each = self.stiffness.level if self.stiffness.confidence is None else self.stiffness.confidence
        return self._together(each)

    @property
    def joint_share(self) -> tuple[float, float] | None:
        """For kind ``"share"``: least and most the share of users within both intervals."""
        return None if self.stiffness.share is None else self._together(self.stiffness.share)

    @property
    def covers(self) -> str:
        """One plain sentence saying what the region covers."""
        least, most = self.joint_level
        sure = f"{percent(least)} to {percent(most)} {_belief(self.method)}"
        if self.joint_share is None:
            return f"{_subject(self.kind, self.family)} lie inside together, with {sure}."
        return (
            f"At least {percent(self.joint_share[0])} of all users lie inside with both values, with {sure}."
        )

    def contains(self, stiffness: ArrayLike, damping: ArrayLike) -> NDArray[np.bool_]:
        """Say which points lie inside, limits included.

        Parameters
        ----------
        stiffness, damping : array_like
            N/m and N·s/m; shapes that broadcast.

        Returns
        -------
        ndarray of bool
            Broadcast shape.
        """
        k, b = np.asarray(stiffness, dtype=float), np.asarray(damping, dtype=float)
        inside_k = (k >= self.stiffness.lower) & (k <= self.stiffness.upper)
        return inside_k & (b >= self.damping.lower) & (b <= self.damping.upper)

    def _together(self, each: float) -> tuple[float, float]:
        left = 1.0 - each
        if self.joint == "bonferroni":
            return each, 1.0 - left / 2.0
        return max(0.0, 1.0 - 2.0 * left), each


@dataclass(frozen=True, kw_only=True, eq=False)
class EllipseRegion(NotebookRecord):
    """An ellipse of stiffness and damping, on the scale of its family.

    Points x with (x − centre)ᵀ shape⁻¹ (x − centre) ≤ radius². Under ``"lognormal"`` centre and shape are
    those of the natural logarithms, and the region a closed curve around an ellipse no longer.

    Parameters
    ----------
    kind : {"mean", "user"}
        What is covered; there is no ellipse of kind ``"share"``.
    method : {"classical", "bayesian"}
        How it was worked out.
    family : {"normal", "lognormal"}
        Scale of `centre` and `shape`.
    level : float
        The level at which stiffness and damping hold together.
    centre : ndarray
        Shape (2,): stiffness, damping (N/m, N·s/m, or their logarithms).
    shape : ndarray
        Shape (2, 2): covariance in the same order.
    radius : float
        Mahalanobis distance of the curve from the centre.
    n : int
        Users.
    """

    kind: Literal["mean", "user"]
    method: Method
    family: Literal["normal", "lognormal"]
    level: float
    centre: NDArray[np.float64]
    shape: NDArray[np.float64]
    radius: float
    n: int
    joint: Literal["hotelling"] = "hotelling"

    def __post_init__(self) -> None:
        if self.centre.shape != (2,) or self.shape.shape != (2, 2):
            raise UsageError(
                f"An ellipse has a centre of shape (2,) and a shape of (2, 2); got {self.centre.shape} and "
                f"{self.shape.shape}."
            )
        if not (self.shape[0, 0] > 0.0 and self.shape[1, 1] > 0.0 and abs(self.correlation) < 1.0):
            raise UsageError("The shape of an ellipse must be a positive definite covariance.")

    @property
    def spread(self) -> NDArray[np.float64]:
        """SDs of stiffness and damping, shape (2,), on the family's scale."""
        return np.sqrt(np.diagonal(self.shape))

    @property
    def correlation(self) -> float:
        """Correlation of stiffness and damping on the family's scale."""
        return float(self.shape[0, 1] / np.sqrt(self.shape[0, 0]) / np.sqrt(self.shape[1, 1]))

    @property
    def joint_level(self) -> tuple[float, float]:
        """Least and most the level of both together can be: here exactly `level`."""
        return self.level, self.level

    @property
    def covers(self) -> str:
        """One plain sentence saying what the region covers."""
        sure = f"{percent(self.level)} {_belief(self.method)}"
        return f"{_subject(self.kind, self.family)} lie inside together, with {sure} (from {self.n} users)."

    def distance(self, stiffness: ArrayLike, damping: ArrayLike) -> NDArray[np.float64]:
        """Return the Mahalanobis distance of points from the centre.

        Parameters
        ----------
        stiffness, damping : array_like
            N/m and N·s/m; shapes that broadcast.

        Returns
        -------
        ndarray
            Broadcast shape; infinite where the lognormal family has no logarithm.
        """
        k, b = (self._scaled(np.asarray(v, dtype=float)) for v in (stiffness, damping))
        u, v = (k - self.centre[0]) / self.spread[0], (b - self.centre[1]) / self.spread[1]
        r = self.correlation
        with np.errstate(invalid="ignore"):
            squared = (u - r * v) ** 2 / ((1.0 - r) * (1.0 + r)) + v**2
        return np.where(np.isfinite(u) & np.isfinite(v), np.sqrt(squared), np.inf)

    def contains(self, stiffness: ArrayLike, damping: ArrayLike) -> NDArray[np.bool_]:
        """Say which points lie inside, the curve included.

        Parameters
        ----------
        stiffness, damping : array_like
            N/m and N·s/m; shapes that broadcast.

        Returns
        -------
        ndarray of bool
            Broadcast shape.
        """
        return self.distance(stiffness, damping) <= self.radius

    def curve(self, angle: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return points of the curve.

        Parameters
        ----------
        angle : array_like
            rad, on the circle the ellipse is the image of.

        Returns
        -------
        stiffness, damping : ndarray
            N/m and N·s/m, of the shape of `angle`.
        """
        phi = np.asarray(angle, dtype=float)
        r = self.correlation
        u = np.cos(phi)
        v = r * u + np.sqrt((1.0 - r) * (1.0 + r)) * np.sin(phi)
        k = self.centre[0] + self.radius * self.spread[0] * u
        b = self.centre[1] + self.radius * self.spread[1] * v
        return (np.exp(k), np.exp(b)) if self.family == "lognormal" else (k, b)

    def limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the smallest rectangle around the region.

        Returns
        -------
        stiffness, damping : tuple of float
            Lower and upper limit, N/m and N·s/m.
        """
        ends = self.centre[:, None] + self.radius * self.spread[:, None] * np.array([-1.0, 1.0])
        (k_low, k_high), (b_low, b_high) = (np.exp(ends) if self.family == "lognormal" else ends).tolist()
        return (k_low, k_high), (b_low, b_high)

    def _scaled(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.family == "normal":
            return values
        return np.log(values, out=np.full_like(values, -np.inf), where=values > 0.0)


def _subject(kind: Kind, family: Family) -> str:
    if kind == "user":
        return "The next user's stiffness and damping"
    who = {"normal": "average", "lognormal": "typical (geometric-mean)", "free": "middle"}[family]
    return f"The {who} user's stiffness and damping"


def _belief(method: Method) -> str:
    return "confidence" if method == "classical" else "probability under the model and its priors"
