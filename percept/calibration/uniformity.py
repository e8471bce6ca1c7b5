"""Whether values are uniform: counts in equal bins, and a band that holds them all at once."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter
from scipy import stats

from percept.calibration.studies import Line
from percept.provenance import Made, markdown_table

__all__ = [
    "Calibration",
    "EcdfBand",
    "Uniformity",
    "ecdf_band",
    "judge_places",
    "sbc_markdown",
    "write_calibrations",
]

Counts = NDArray[np.int64]
# Probability that a right density is called wrong, per design.
_ERROR = 0.01
# Halvings of the search for a band: its tail probability is then exact to twelve digits.
_HALVINGS = 40


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
    """Verdict on one design."""

    design: str  # As `SbcPlan`
    fits: int
    failed: int
    reasons: tuple[str, ...]  # Why, each reason once
    error: float  # Probability of any quantity leaving its band if all is right, at most
    tail: float  # The band's tail probability at one edge
    lower: tuple[int, ...]  # Of the band, at each edge
    upper: tuple[int, ...]
    quantities: tuple[Uniformity, ...]  # Scales, correlations, locations, distribution functions

    @property
    def outside(self) -> tuple[str, ...]:
        """Quantities outside the band."""
        return tuple(judged.quantity for judged in self.quantities if not judged.inside)


def judge_places(design: str, bins: int, placed: Sequence[Line]) -> Calibration:
    """Judge all quantities of a design together.

    Parameters
    ----------
    design : str
        Name of the design.
    bins : int
        Equal bins to count in.
    placed : sequence of Line
        What `percept.calibration.sbc.place_study` gives of each study.

    Returns
    -------
    Calibration
    """
    passed = [study["values"] for study in placed if not study["reason"]]
    reasons = [study["reason"] for study in placed if study["reason"]]
    names = list(passed[0]) if passed else []
    # The error is shared among the quantities.
    band = ecdf_band(len(passed), bins, _ERROR / max(len(names), 1))
    judged = [band.judge(name, np.array([values[name] for values in passed])) for name in names]
    return Calibration(
        design=design,
        fits=len(placed),
        failed=len(reasons),
        reasons=tuple(dict.fromkeys(reasons)),
        error=_ERROR,
        tail=band.tail,
        lower=tuple(band.lower.tolist()),
        upper=tuple(band.upper.tolist()),
        quantities=tuple(judged),
    )


def write_calibrations(
    calibrations: Sequence[Calibration], directory: str | os.PathLike[str], made: Made
) -> None:
    """Write verdicts as `sbc.json` (everything) and `sbc.md` (a table with how to read it).

    Verdicts on other designs that the folder holds already stay.

    Parameters
    ----------
    calibrations : sequence of Calibration
        The verdicts.
    directory : str or path-like
        Folder, made where it does not exist.
    made : Made
        The commit, command and date that the page names.
    """
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "sbc.json"
    kept: tuple[Calibration, ...] = ()
    if path.exists():
        kept = TypeAdapter(tuple[Calibration, ...]).validate_json(path.read_bytes())
    by_design = {calibration.design: calibration for calibration in (*kept, *calibrations)}
    rows = []
    for calibration in by_design.values():
        rows.append({**dataclasses.asdict(calibration), "outside": calibration.outside})
    path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    total = sum(calibration.fits for calibration in by_design.values())
    head = (
        f"# Simulation-based calibration\n\n{total} studies were drawn from the prior and fitted."
        " True scales, correlations and locations are ranked among independent posterior draws;"
        " `mean` and `user` are the posterior distribution functions at the true mean and at a new"
        " user. Each design's quantities are judged together by simultaneous bands that a right"
        f" density leaves with a probability of at most {100 * _ERROR:g} %. Fits the gate withheld"
        " are counted as failed and give no ranks. With few fits only large errors"
        f" show.\n\n{made.sentence}\n\n"
    )
    (folder / "sbc.md").write_text(head + sbc_markdown(list(by_design.values())), encoding="utf-8")


def sbc_markdown(calibrations: Sequence[Calibration]) -> str:
    """Write verdicts as a table in Markdown.

    Parameters
    ----------
    calibrations : sequence of Calibration
        The verdicts.

    Returns
    -------
    str
    """
    heads = ["design", "fits", "failed", "quantities", "outside", "farthest", "tail", "band"]
    rows = []
    for calibration in calibrations:
        farthest = ""
        tail = ""
        quantities = calibration.quantities
        if quantities:
            worst = min(quantities, key=lambda judged: judged.least_tail)
            farthest = worst.quantity
            tail = f"{worst.least_tail:.2g}"
        counts = [calibration.fits, calibration.failed, len(quantities), len(calibration.outside)]
        rows.append([calibration.design, *counts, farthest, tail, f"{calibration.tail:.2g}"])
    return markdown_table(heads, rows)
