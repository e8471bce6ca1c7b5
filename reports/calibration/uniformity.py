"""Whether values are uniform: counts in equal bins, and a band that holds them all at once."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from percept.checkpoint import Line, plan_digest
from percept.errors import RefusalError
from percept.workers import Mapper, in_process
from reports.page import store

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
#: Probability that a right density is called wrong, per kind of study.
ERROR = 0.01
# Halvings of the search for a band: its tail probability is then exact to twelve digits.
_HALVINGS = 40


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """Studies of one kind, to be drawn from the prior and fitted many times."""

    kind: str
    wrong: str = ""  # The wrong model that they are fitted by
    seed: int = 1  # Of the whole
    # Independent posterior draws that a true value is ranked among. One less than a multiple of the
    # bins gives each bin equally many ranks.
    draws: int = 199
    bins: int = 20  # Equal bins that the ranks are counted in
    tolerance: float = 0.2  # Of the sampler, on limits: ranks need no more than independent draws

    @property
    def name(self) -> str:
        """What the page calls it."""
        return self.wrong or self.kind


#: Draws a study of a plan by its number, fits it and places its true values: a probability each.
Place: TypeAlias = Callable[[Plan, int], dict[str, float]]


class EcdfBand:
    """Bounds of the number of uniform values below each inner edge of equal bins.

    Parameters
    ----------
    count : int
        Number of values.
    bins : int
        Equal bins of (0, 1).
    tail : float
        Probability of a count beyond the bounds at one edge, both sides together.
    """

    def __init__(self, count: int, bins: int, tail: float) -> None:
        self.count = count
        self.tail = tail
        self.edges = np.arange(1, bins) / bins
        lower = stats.binom.ppf(0.5 * tail, count, self.edges)
        upper = stats.binom.isf(0.5 * tail, count, self.edges)
        self.lower: Counts = np.asarray(lower, dtype=np.int64)
        self.upper: Counts = np.asarray(upper, dtype=np.int64)

    def probability(self) -> float:
        """Probability that uniform values stay within the bounds at all edges at once.

        Counts below successive edges are a Markov chain with binomial steps, so the probability is
        a product of small matrices (Säilynoja, Bürkner & Vehtari 2022).
        """
        counts = np.arange(self.lower[0], self.upper[0] + 1)
        mass = stats.binom.pmf(counts, self.count, self.edges[0])
        for k in range(1, self.edges.size):
            # Probability that a value above the last edge lies below this one.
            step = (self.edges[k] - self.edges[k - 1]) / (1.0 - self.edges[k - 1])
            next_counts = np.arange(self.lower[k], self.upper[k] + 1)
            increments = next_counts[None, :] - counts[:, None]
            left = (self.count - counts)[:, None]
            mass = mass @ stats.binom.pmf(increments, left, step)
            counts = next_counts
        return float(mass.sum())

    def judge(self, quantity: str, values: NDArray[np.float64]) -> Uniformity:
        """Count values below each edge and say whether the counts stay within the bounds."""
        below = np.searchsorted(np.sort(values), self.edges, side="left")
        low = stats.binom.cdf(below, self.count, self.edges)
        high = stats.binom.sf(below - 1, self.count, self.edges)
        inside = (below >= self.lower) & (below <= self.upper)
        least = 2.0 * np.minimum(low, high).min()
        return Uniformity(
            quantity=quantity,
            inside=bool(np.all(inside)),
            least_tail=float(min(1.0, least)),
            below=tuple(below.tolist()),
        )


@functools.cache
def ecdf_band(count: int, bins: int, error: float) -> EcdfBand:
    """Find the narrowest band that uniform values leave with at most the probability given.

    Parameters
    ----------
    count : int
        Number of values.
    bins : int
        Equal bins of (0, 1).
    error : float
        Probability that uniform values leave the band anywhere.

    Returns
    -------
    EcdfBand
    """
    # Logarithms of error/tail. One edge alone has zero, and a union of all edges the upper one.
    low = 0.0
    high = float(np.log(bins))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if EcdfBand(count, bins, error * float(np.exp(-middle))).probability() >= 1.0 - error:
            high = middle
        else:
            low = middle
    return EcdfBand(count, bins, error * float(np.exp(-high)))


@dataclasses.dataclass(frozen=True)
class Uniformity:
    """Verdict on one quantity."""

    quantity: str  # Such as "sigma[k,VE1]", "mean[b,VE2]" or "rho_w"
    inside: bool  # Whether its empirical distribution stays inside the band
    least_tail: float  # Smallest two-sided tail probability of a count, over the edges of the bins
    below: tuple[int, ...]  # Values below each edge


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Verdict on one kind of study."""

    kind: str  # Of study, or the wrong model it is fitted by
    fits: int
    reasons: tuple[str, ...]  # Why fits failed
    tail: float  # The band's tail probability at one edge
    quantities: tuple[Uniformity, ...]  # Scales, correlations, distribution functions

    @property
    def outside(self) -> list[str]:
        """Quantities outside the band."""
        return [judged.quantity for judged in self.quantities if not judged.inside]

    @property
    def row(self) -> list[object]:
        """What a table says of it."""
        counts = [self.fits, len(self.reasons), len(self.quantities), len(self.outside)]
        if not self.quantities:
            return [self.kind, *counts, "", "", self.tail]
        worst = min(self.quantities, key=lambda judged: judged.least_tail)
        return [self.kind, *counts, worst.quantity, worst.least_tail, self.tail]


def judge_places(kind: str, bins: int, lines: Sequence[Line]) -> Calibration:
    """Judge all quantities of a kind of study together, by the places of their true values."""
    values = [study["values"] for study in lines if not study["reason"]]
    reasons = [study["reason"] for study in lines if study["reason"]]
    names = list(values[0]) if values else []
    # The error is shared among the quantities.
    band = ecdf_band(len(values), bins, ERROR / max(len(names), 1))
    judged = [band.judge(name, np.array([each[name] for each in values])) for name in names]
    return Calibration(kind, len(lines), tuple(reasons), band.tail, tuple(judged))


def placed(place: Place, plan: Plan, index: int) -> Line:
    """Place the true values of study `index`; without a fit, say why there is none."""
    try:
        return {"reason": "", "values": place(plan, index)}
    except RefusalError as refusal:
        return {"reason": str(refusal), "values": {}}


def calibrate(
    plan: Plan,
    place: Place,
    fits: int,
    *,
    folder: Path | None = None,
    mapper: Mapper = in_process,
    progress: Callable[[int, int], None] | None = None,
) -> Calibration:
    """Place true values of many studies, and judge them together.

    Parameters
    ----------
    plan : Plan
        The kind of study.
    place : Place
        Works on one study.
    fits : int
        How many studies.
    folder : Path, optional
        Keeps placed studies, so that an interrupted run goes on.
    mapper : Mapper
        The workers.
    progress : callable, optional
        Told how many studies are finished, and of how many.
    """
    kept = store(folder, plan_digest(plan))
    study = functools.partial(placed, place, plan)
    lines = kept.complete(study, fits, mapper=mapper, progress=progress)
    return judge_places(plan.name, plan.bins, lines)
