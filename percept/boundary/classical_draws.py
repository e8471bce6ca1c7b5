"""Draws of (k, b) that stand for what a sample says, so that classical curves can be drawn through them.

Eq. 15 comes from a distribution: X̄ + t·SD/√n, t with ν = n − 1. With stiffness and damping of the same
subjects the matching distribution of both is the bivariate t_ν about the means with the sample covariance:
each margin is Eq. 15's (or the prediction interval's) exactly, and k and b go together as the sample does. It
is the posterior under the prior abs(Σ)^−2, by inverse Wishart Σ; between the margins its coverage is close
to its level, not exact.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.classical.moments import sample

Array = NDArray[np.float64]

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def confidence_draws(
    stiffness: ArrayLike,
    damping: ArrayLike,
    *,
    kind: str,
    family: Literal["normal", "lognormal"],
    draws: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Draw (k, b) of the average or the next user from the distribution behind the classical intervals."""
    if kind not in ("mean", "user"):
        raise UsageError(
            'kind must be "mean" or "user": a share of users has no curve of its own.', value=kind
        )
    k, b = (sample(x, positive=family == "lognormal", least=3) for x in (stiffness, damping))
    if k.ndim != 1 or k.shape != b.shape:
        raise UsageError(f"one stiffness and one damping per subject are needed: {k.shape}, {b.shape}.")
    values = np.stack([k, b])
    if family == "lognormal":
        values = np.log(values)
    n = k.size
    centre = values.mean(axis=1)
    sd = values.std(axis=1, ddof=1)
    if not (sd > 0).all():
        raise RefusalError("all subjects adjusted alike: there is no scatter to draw from.")
    deviations = (values - centre[:, None]) / sd[:, None]
    correlation = float(np.clip(deviations[0] @ deviations[1] / (n - 1), -1.0, 1.0))
    z = _bivariate_t(correlation, n - 1, draws, rng)
    widened = np.sqrt(1.0 / n if kind == "mean" else 1.0 + 1.0 / n)
    drawn = centre[:, None] + widened * sd[:, None] * z
    if family == "lognormal":
        with np.errstate(over="ignore", under="ignore"):
            drawn = np.exp(drawn)
    return drawn[0], drawn[1]


def _bivariate_t(correlation: float, freedom: int, draws: int, rng: np.random.Generator) -> Array:
    """Draw from the standard bivariate t, shape (2, draws).

    Its radius has P(R² > r²) = (1 + r²/ν)^(−ν/2) and its angle is even: a sunflower's seeds.
    """
    index = rng.permutation(draws)
    beyond = (index + rng.random()) / draws
    radius = np.sqrt(freedom * np.expm1(-2.0 / freedom * np.log(np.maximum(beyond, 0.5 / draws))))
    angle = 2.0 * np.pi * (_GOLDEN * index + rng.random())
    first, second = radius * np.cos(angle), radius * np.sin(angle)
    return np.stack(
        [first, correlation * first + np.sqrt((1.0 - correlation) * (1.0 + correlation)) * second]
    )
