"""Calibrate several designs one after the other and write down what was found."""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from percept.calibration.sbc import Calibration, calibrate, sbc_markdown
from percept.calibration.sbc_plan import SBC_DESIGNS, Fault, SbcPlan
from percept.workers import Mapper


def calibrate_designs(
    fits: int,
    *,
    designs: Sequence[str] = tuple(SBC_DESIGNS),
    fault: Fault = "none",
    seed: int = 1,
    mapper: Mapper | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    seconds: float | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[Calibration]:
    """Calibrate designs with equal shares of the time that is left."""
    stop = None if seconds is None else time.monotonic() + seconds
    found = []
    for done, design in enumerate(designs):
        share = None if stop is None else (stop - time.monotonic()) / (len(designs) - done)

        def tell(count: int, of: int, design: str = design) -> None:
            if progress:
                progress(design, count, of)

        plan = SbcPlan(design=design, seed=seed, fault=fault)
        found.append(
            calibrate(plan, fits, mapper=mapper, checkpoint=checkpoint, seconds=share, progress=tell)
        )
    return found


def write_calibrations(found: Sequence[Calibration], directory: str | os.PathLike[str]) -> None:
    """Write verdicts as `sbc.json` (everything) and `sbc.md` (a table with how to read it)."""
    to = Path(directory)
    to.mkdir(parents=True, exist_ok=True)
    rows = [{**dataclasses.asdict(one), "outside": list(one.outside)} for one in found]
    (to / "sbc.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    total = sum(one.fits for one in found)
    head = (
        "# Simulation-based calibration\n\n"
        f"{total} studies were drawn from the prior and fitted. True scales, correlations and "
        "locations are ranked among independent posterior draws; `mean` and `user` are the posterior "
        "distribution functions at the true mean and at a new user. Each design's quantities are judged "
        "together by simultaneous bands that a right density leaves with a probability of at most "
        f"{100 * max((one.error for one in found), default=0.0):g} %. Fits the gate withheld are counted as "
        "failed and give no ranks. With few fits only large errors show.\n\n"
    )
    (to / "sbc.md").write_text(head + sbc_markdown(list(found)), encoding="utf-8")
