"""Intervals that assume no distribution: limits are order statistics of the sample.

From the r-th smallest to the r-th largest value, with r as large as the level allows. What they hold is exact
for any continuous distribution; what they need is subjects, so the usual answer is how many.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.inference.classical.checks import sample
from percept.inference.classical.claims import Claim
from percept.inference.classical.moments import Moments, plain
from percept.inference.intervals import Interval, Kind

Array: TypeAlias = NDArray[np.float64]

_ROUNDING = 1e-12  # 1 − 0.9 falls short of 0.1 by some 2e-16: a level met but for that is met


def free_interval(kind: Kind, x: ArrayLike | Moments, claim: Claim, *, axis: int = -1) -> Interval:
    """Return the narrowest symmetric pair of order statistics that keeps the claim."""
    if isinstance(x, Moments):
        raise UsageError(
            "Order statistics need the values themselves, not their mean and SD.",
            hint='Use family="normal" or "lognormal".',
        )
    ordered = np.sort(sample(x, axis=axis), axis=-1)
    if (ordered[..., 0] == ordered[..., -1]).any():
        raise RefusalError("All subjects gave the same value: with no scatter there is no interval.")
    n = ordered.shape[-1]
    miss, allowed = _miss(kind, claim)
    missed = miss(float(n), np.arange(1.0, n // claim.tails + 1.0))
    rank = int(np.count_nonzero(missed <= allowed))
    if rank == 0:
        needed = least_subjects(kind, claim)
        raise RefusalError(
            f"{n} subjects are too few to say this of any distribution: it takes {needed}.",
            hint='Use family="normal" or "lognormal", or a lower level.',
        )
    lower, upper = ordered[..., rank - 1], ordered[..., n - rank]
    return Interval(
        kind=kind,
        method="classical",
        family="free",
        level=float(claim.level),
        lower=plain(np.full_like(lower, -np.inf) if claim.side == "upper" else lower),
        upper=plain(np.full_like(upper, np.inf) if claim.side == "lower" else upper),
        estimate=plain(np.median(ordered, axis=-1)),
        n=n,
        share=None if claim.share is None else float(claim.share),
        confidence=None if claim.confidence is None else float(claim.confidence),
        joint=claim.joint,
        side=claim.side,
        attained=1.0 - float(missed[rank - 1]),
        unit=claim.unit,
    )


def least_subjects(kind: Kind, claim: Claim) -> int:
    """Return the smallest number of subjects whose extremes keep the claim."""
    miss, allowed = _miss(kind, claim)
    few, enough = 1, 2
    while miss(float(enough), np.ones(1))[0] > allowed:
        few, enough = enough, 2 * enough
    while enough - few > 1:
        middle = (few + enough) // 2
        if miss(float(middle), np.ones(1))[0] > allowed:
            few = middle
        else:
            enough = middle
    return enough


def _miss(kind: Kind, claim: Claim) -> tuple[Callable[[float, Array], Array], float]:
    """Return the probability of missing, given n and rank, and how much of it is allowed."""
    tails = claim.tails
    allowed = claim.tail("confidence" if kind == "share" else "level") * (1.0 + _ROUNDING)
    if kind == "mean":
        return lambda n, rank: tails * special.betainc(n - rank + 1.0, rank, 0.5), allowed
    if kind == "user":
        return lambda n, rank: tails * rank / (n + 1.0), allowed
    outside = claim.tail("share")

    def short(n: float, rank: Array) -> Array:
        # the share held is a beta variable; its complement, so that a share near one keeps its digits
        return np.asarray(special.betaincc(tails * rank, n + 1.0 - tails * rank, outside))

    return short, allowed
