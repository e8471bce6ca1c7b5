"""Stiffness and damping together: rectangles of intervals, and Hotelling's ellipse."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.classical.checks import sample
from percept.inference.classical.claims import Parametric, parametric_family
from percept.inference.classical.levels import Level, tail
from percept.inference.classical.moments import Moments, mean_and_sd
from percept.inference.classical.sample_intervals import interval_of
from percept.inference.intervals import Family, Interval, Joint, Kind
from percept.inference.regions import EllipseRegion, RectangleRegion

_ON_A_LINE = 1e-13  # 1 − r² below this is rounding of the data


def rectangle_region(
    stiffness: ArrayLike | Moments,
    damping: ArrayLike | Moments,
    *,
    kind: Kind,
    level: Level = 0.99,
    share: Level | None = None,
    confidence: Level = 0.95,
    family: Family = "normal",
    joint: Joint = "marginal",
) -> RectangleRegion:
    """Put an interval of stiffness and one of damping together.

    Parameters
    ----------
    stiffness, damping : array_like or Moments
        One value per subject, shape (n,), N/m and N·s/m; or moments.
    kind : {"mean", "user", "share"}
        What is covered.
    level, share, confidence : float or OneMinus
        As `tolerance_interval`.
    family : {"normal", "lognormal", "free"}
        Distribution between users.
    joint : {"marginal", "bonferroni"}
        ``"marginal"`` (the paper's) leaves each interval its level, so that both hold together with less;
        ``"bonferroni"`` widens them so that both hold together at `level`.

    Returns
    -------
    RectangleRegion
        Its `joint_level` says between what levels both hold.

    Raises
    ------
    UsageError, RefusalError
        As `t_interval`; an unknown kind; samples that are not of one environment.
    """

    def interval(x: ArrayLike | Moments) -> Interval:
        return interval_of(
            kind, x, level=level, share=share, confidence=confidence, family=family, joint=joint
        )

    return RectangleRegion(stiffness=interval(stiffness), damping=interval(damping))


def ellipse_region(
    stiffness: ArrayLike | Moments,
    damping: ArrayLike | Moments,
    *,
    kind: Kind,
    level: Level = 0.99,
    family: Parametric = "normal",
) -> EllipseRegion:
    """Work out Hotelling's ellipse, which holds stiffness and damping together at exactly `level`.

    With two parameters the F quantile is elementary: radius² = (n − 1)(α^{−2/(n−2)} − 1)·q, with α =
    1 − level, and q = 1/n for the mean, 1 + 1/n for the next user.

    Parameters
    ----------
    stiffness, damping : array_like
        Shape (n,): values of the same subjects in the same order, N/m and N·s/m.
    kind : {"mean", "user"}
        What is covered.
    level : float or OneMinus
        Level of both together.
    family : {"normal", "lognormal"}
        Distribution between users.

    Returns
    -------
    EllipseRegion
        On the scale of the family.

    Raises
    ------
    UsageError
        Unfit values, shapes that differ, an unknown kind or family, a level outside (0, 1).
    RefusalError
        Published figures in place of values, kind ``"share"``, fewer than 3 subjects, no scatter, subjects
        on a line, zero or negative values under ``"lognormal"``.
    """
    if kind == "share":
        raise RefusalError(
            "There is no exact ellipse of a share of users.", hint='Use rectangle_region(joint="bonferroni").'
        )
    if kind not in ("mean", "user"):
        raise UsageError('kind must be "mean" or "user".', value=kind)
    parametric_family(family)
    if isinstance(stiffness, Moments) or isinstance(damping, Moments):
        raise RefusalError(
            "Means and SDs say nothing on how stiffness and damping go together.",
            hint='Use rectangle_region(joint="bonferroni"), or the values of the subjects.',
        )
    left = tail(level)
    if left.ndim:
        raise UsageError("level must be one number for a region.", value=level)
    k, b = (sample(x, positive=family == "lognormal", least=3) for x in (stiffness, damping))
    if k.ndim != 1 or k.shape != b.shape:
        raise UsageError(f"One stiffness and one damping per subject are needed: {k.shape}, {b.shape}.")
    if family == "lognormal":
        k, b = np.log(k), np.log(b)
    n = k.size
    centre, shape = _centre_and_shape(k, b)
    stretch = (n - 1) * math.expm1(-2.0 * math.log(float(left)) / (n - 2))
    return EllipseRegion(
        kind=kind,
        method="classical",
        family=family,
        level=float(level),
        centre=centre,
        shape=shape,
        radius=math.sqrt(stretch * (1.0 / n if kind == "mean" else 1.0 + 1.0 / n)),
        n=n,
    )


def _centre_and_shape(
    k: NDArray[np.float64], b: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    pair = np.stack([k, b])
    centre, sd = mean_and_sd(pair)
    if (sd == 0.0).any():
        raise RefusalError(
            "All subjects gave the same stiffness, or damping: with no scatter there is no ellipse."
        )
    # deviations from an element of the sample first, so that an offset does not round them
    shifted = pair - pair[:, :1]
    unit = (shifted - mean_and_sd(shifted)[0][:, None]) / sd[:, None]
    r = math.fsum(unit[0] * unit[1]) / (k.size - 1)
    if 1.0 - r * r < _ON_A_LINE:
        raise RefusalError(
            "Stiffness and damping of the subjects lie on a line: there is no ellipse.",
            hint='Use rectangle_region(joint="bonferroni").',
        )
    off = r * sd[0] * sd[1]
    return centre, np.array([[sd[0] ** 2, off], [off, sd[1] ** 2]])
