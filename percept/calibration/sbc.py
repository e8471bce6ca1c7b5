"""Simulation-based calibration (Talts et al. 2018): the posterior must hold what the prior says.

Studies are drawn from the prior and fitted. Over them, a true value's rank among independent
posterior draws is uniform, and so is the posterior distribution function at it, if the density, the
sampler and the conditionals are right. All quantities of a design are judged together, by
simultaneous bands.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from percept.calibration.placing import SbcPlan, place_study
from percept.calibration.studies import Checkpoint
from percept.errors import UsageError
from percept.provenance import Made
from percept.workers import Mapper

Counts = NDArray[np.int64]
#: Probability that a right density is called wrong, per design.
ERROR = 0.01
_HALVINGS = 40


class EcdfBand:
    """Bounds of the number of values below each inner edge of equal bins, for values that are uniform."""

    def __init__(self, count: int, bins: int, tail: float) -> None:
        self.count, self.tail = count, tail
        self.edges = np.arange(1, bins) / bins
        self.lower: Counts = np.asarray(
            stats.binom.ppf(0.5 * tail, count, self.edges), dtype=np.int64
        )
        self.upper: Counts = np.asarray(
            stats.binom.isf(0.5 * tail, count, self.edges), dtype=np.int64
        )

    def probability(self) -> float:
        """Probability that uniform values stay within the bounds at all edges at once.

        Counts below successive edges are a Markov chain with binomial steps, so the probability is
        a product of small matrices (Säilynoja, Bürkner & Vehtari 2022).
        """
        at = np.arange(self.lower[0], self.upper[0] + 1)
        mass = stats.binom.pmf(at, self.count, self.edges[0])
        for k in range(1, self.edges.size):
            step = (self.edges[k] - self.edges[k - 1]) / (1.0 - self.edges[k - 1])
            to = np.arange(self.lower[k], self.upper[k] + 1)
            mass = mass @ stats.binom.pmf(
                to[None, :] - at[:, None], (self.count - at)[:, None], step
            )
            at = to
        return float(mass.sum())

    def judge(self, quantity: str, values: NDArray[np.float64]) -> Uniformity:
        """Count values below each edge and say whether the counts stay within the bounds."""
        below = np.searchsorted(np.sort(values), self.edges, side="left")
        low = stats.binom.cdf(below, self.count, self.edges)
        high = stats.binom.sf(below - 1, self.count, self.edges)
        return Uniformity(
            quantity=quantity,
            inside=bool(np.all((below >= self.lower) & (below <= self.upper))),
            least_tail=float(min(1.0, 2.0 * np.minimum(low, high).min())),
            below=tuple(below.tolist()),
        )


@functools.cache
def ecdf_band(count: int, bins: int, error: float) -> EcdfBand:
    """Find the narrowest band that uniform values leave with at most the probability given."""
    low, high = (
        0.0,
        float(np.log(bins)),
    )  # logarithms of error/tail: between one edge and a union of all
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
    quantities: tuple[
        Uniformity, ...
    ]  # Every scale, correlation, location and distribution function

    @property
    def outside(self) -> tuple[str, ...]:
        """Quantities outside the band."""
        return tuple(one.quantity for one in self.quantities if not one.inside)


def calibrate(
    plan: SbcPlan,
    fits: int,
    *,
    mapper: Mapper | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Calibration:
    """Simulate, fit and judge studies of one design."""
    if fits < 1:
        raise UsageError("a calibration needs at least one study.", key="fits", value=fits)
    place, kept = (
        functools.partial(place_study, plan),
        Checkpoint(checkpoint, plan.key, what="placed"),
    )
    return judge_places(plan, kept.complete(place, fits, mapper=mapper, progress=progress))


def judge_places(plan: SbcPlan, placed: list[dict[str, Any]]) -> Calibration:
    """Judge all quantities of a design together."""
    passed = [one["values"] for one in placed if not one["reason"]]
    names = list(passed[0]) if passed else []
    band = ecdf_band(len(passed), plan.bins, ERROR / max(len(names), 1))
    return Calibration(
        design=plan.design,
        fits=len(placed),
        failed=len(placed) - len(passed),
        reasons=tuple(dict.fromkeys(one["reason"] for one in placed if one["reason"])),
        error=ERROR,
        tail=band.tail,
        lower=tuple(band.lower.tolist()),
        upper=tuple(band.upper.tolist()),
        quantities=tuple(
            band.judge(name, np.array([one[name] for one in passed])) for name in names
        ),
    )


def write_calibrations(
    found: Sequence[Calibration], directory: str | os.PathLike[str], made: Made
) -> None:
    """Write verdicts as `sbc.json` (everything) and `sbc.md` (a table with how to read it).

    Verdicts on other designs that the folder holds already stay.
    """
    to = Path(directory)
    to.mkdir(parents=True, exist_ok=True)
    path = to / "sbc.json"
    rows = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    rows += [{**dataclasses.asdict(one), "outside": list(one.outside)} for one in found]
    rows = list({row["design"]: row for row in rows}.values())
    path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    total = sum(row["fits"] for row in rows)
    head = (
        f"# Simulation-based calibration\n\n{total} studies were drawn from the prior and fitted."
        " True scales, correlations and locations are ranked among independent posterior draws;"
        " `mean` and `user` are the posterior distribution functions at the true mean and at a new"
        " user. Each design's quantities are judged together by simultaneous bands that a right"
        f" density leaves with a probability of at most {100 * ERROR:g} %. Fits the gate withheld"
        " are counted as failed and give no ranks. With few fits only large errors"
        f" show.\n\n{made.sentence}\n\n"
    )
    (to / "sbc.md").write_text(head + sbc_markdown(rows), encoding="utf-8")


def sbc_markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Write verdicts, as `sbc.json` holds them, as a table in Markdown."""
    lines = [
        "| design | fits | failed | quantities | outside | farthest | tail | band |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        worst = min(row["quantities"], key=lambda q: q["least_tail"], default=None)
        cells = [
            row["design"], row["fits"], row["failed"], len(row["quantities"]), len(row["outside"]),
            worst["quantity"] if worst else "", f"{worst['least_tail']:.2g}" if worst else "",
            f"{row['tail']:.2g}",
        ]  # fmt: skip
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"
