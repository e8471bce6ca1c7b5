"""Simulation-based calibration (Talts et al. 2018): the posterior must hold what the prior says.

Studies are drawn from the prior and fitted. Over them, a true value's rank among independent posterior
draws is uniform, and so is the posterior distribution function at it, if the density, the sampler and
the conditionals are right. All quantities of a design are judged together, by simultaneous bands.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import os
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from percept.calibration.bands import ecdf_band
from percept.calibration.checkpoint import Checkpoint
from percept.calibration.sbc_fit import Placed, place_study
from percept.calibration.sbc_plan import FAULTS, SbcPlan
from percept.calibration.studies import computed
from percept.errors import UsageError
from percept.workers import InProcess, Mapper

#: Probability that a right density is called wrong, per design.
ERROR = 0.01


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
    fault: str  # As `SbcPlan`
    fits: int
    failed: int
    reasons: tuple[str, ...]  # Why, each reason once
    error: float  # Probability of any quantity leaving its band if all is right, at most
    tail: float  # The band's tail probability at one edge
    lower: tuple[int, ...]  # The band
    upper: tuple[int, ...]  # The band
    quantities: tuple[Uniformity, ...]  # Every scale, correlation, location and distribution function

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
    seconds: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Calibration:
    """Simulate, fit and judge studies of one design."""
    if fits < 1:
        raise UsageError("a calibration needs at least one study.", key="fits", value=fits)
    kept = Checkpoint(checkpoint, plan.key, what="placed", pack=dataclasses.asdict, unpack=_unpack)
    placed = kept.read(fits)
    wanted = [index for index in range(fits) if index not in placed]
    stop = None if seconds is None else time.monotonic() + seconds
    started = itertools.takewhile(lambda _: stop is None or time.monotonic() < stop, wanted)
    place = functools.partial(place_study, plan)
    for index, one in computed(place, started, mapper or InProcess(), name=f"sbc-{plan.key}"):
        placed[index] = one
        kept.append(index, one)
        if progress:
            progress(len(placed), fits)
    return judge_places(plan, [placed[index] for index in sorted(placed)])


def judge_places(plan: SbcPlan, placed: list[Placed]) -> Calibration:
    """Judge all quantities of a design together."""
    passed = [one.values for one in placed if not one.reason]
    reasons = tuple(dict.fromkeys(one.reason for one in placed if one.reason))
    names = list(passed[0]) if passed else []
    band = ecdf_band(len(passed), plan.bins, ERROR / max(len(names), 1))
    quantities = []
    for name in names:
        values = np.array([found[name] for found in passed])
        below = tuple(band.below(values).tolist())
        quantities.append(Uniformity(name, band.holds(values), band.least_tail(values), below))
    return Calibration(
        design=plan.design,
        fault=plan.fault,
        fits=len(placed),
        failed=len(placed) - len(passed),
        reasons=reasons,
        error=ERROR,
        tail=band.tail,
        lower=tuple(band.lower.tolist()),
        upper=tuple(band.upper.tolist()),
        quantities=tuple(quantities),
    )


def sbc_markdown(found: list[Calibration]) -> str:
    """Write verdicts as a table in Markdown."""
    lines = [
        "| design | deliberate error | fits | failed | quantities | outside | farthest | tail | band |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for one in found:
        worst = min(one.quantities, key=lambda q: q.least_tail, default=None)
        cells = [
            one.design, FAULTS[one.fault] if one.fault != "none" else "", str(one.fits), str(one.failed),
            str(len(one.quantities)), str(len(one.outside)), worst.quantity if worst else "",
            f"{worst.least_tail:.2g}" if worst else "", f"{one.tail:.2g}",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _unpack(line: Mapping[str, Any]) -> Placed:
    return Placed(line["reason"], dict(line["values"]))
