"""The ellipse that holds a level of the draws of (k, b): the Bayesian counterpart of Hotelling's."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.regions import EllipseRegion

Array = NDArray[np.float64]


def ellipse_of_draws(
    stiffness: Array,
    damping: Array,
    *,
    kind: Literal["mean", "user"],
    family: Literal["normal", "lognormal"],
    level: float,
    n: int,
) -> EllipseRegion:
    """Put an ellipse around draws: their mean and covariance, out to a quantile of Mahalanobis distance."""
    points = np.stack([stiffness, damping])
    if family == "lognormal":
        points = np.log(points)
    centre, shape = points.mean(axis=1), np.cov(points)
    sd = np.sqrt(np.diagonal(shape))
    if not (sd > 0).all() or abs(shape[0, 1]) >= sd[0] * sd[1]:
        raise RefusalError("the draws lie on a line: there is no ellipse around them.")
    unit = EllipseRegion(
        kind=kind, method="bayesian", family=family, level=level, centre=centre, shape=shape, radius=1.0, n=n
    )
    radius = float(np.quantile(unit.distance(stiffness, damping), level))
    return EllipseRegion(
        kind=kind,
        method="bayesian",
        family=family,
        level=level,
        centre=centre,
        shape=shape,
        radius=radius,
        n=n,
    )
