"""What a simulation-based calibration draws, fits and looks at."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Literal, get_args

import numpy as np

from percept.errors import UsageError
from percept.simulate import Design

Fault = Literal["none", "jacobian", "prior", "snooker"]
#: Deliberate errors a calibration must catch, with what each breaks.
FAULTS = {
    "none": "nothing",
    "jacobian": "the prior of log sigma is taken as a density of the variance: no Jacobian",
    "prior": "the fit's prior of log s is a tenth as wide as the truth's",
    "snooker": "draws come from emcee's DESnookerMove, which samples another law",
}
_REFERENCES = np.array([[10.0, 0.1], [1e3, 1.0], [1e4, 10.0], [2.5e4, 25.0], [5e4, 50.0]])


def _missing() -> Design:
    """Eight subjects, two of whom saw only some of four environments, and one of whom repeated one."""
    trials = np.ones((8, 4), dtype=np.int64)
    trials[0, 1] = trials[2, 0] = trials[2, 3] = 0
    trials[5, 1:] = 0
    return Design(_REFERENCES[:4], trials)


#: The six kinds of study that are calibrated.
SBC_DESIGNS: dict[str, Design] = {
    "balanced": Design.balanced(_REFERENCES, subjects=10),
    "trials": Design.balanced(_REFERENCES[:3], subjects=8, trials=3),
    "missing cells": _missing(),
    "one parameter": Design.balanced(_REFERENCES[:4, :1], subjects=8, parameters=("k",)),
    "one environment": Design.balanced(_REFERENCES[2:3], subjects=8),
    "three subjects": Design.balanced(_REFERENCES[:3], subjects=3),
}


@dataclass(frozen=True, kw_only=True)
class SbcPlan:
    """One design, to be simulated from the prior and fitted many times."""

    design: str  # One of `SBC_DESIGNS`
    seed: int = 1  # Of the whole
    draws: int = 199  # Independent posterior draws a true value is ranked among
    bins: int = 20  # Equal bins the ranks are counted in
    tolerance: float = 0.2  # Of the sampler, on the limits of kinds mean and user
    fault: Fault = "none"  # One of `FAULTS`

    def __post_init__(self) -> None:
        if self.design not in SBC_DESIGNS:
            raise UsageError(
                f"no such design; there are {', '.join(SBC_DESIGNS)}.", key="design", value=self.design
            )
        if self.fault not in get_args(Fault):
            raise UsageError(f"no such fault; there are {', '.join(FAULTS)}.", key="fault", value=self.fault)
        if self.bins < 2 or (self.draws + 1) % self.bins:
            raise UsageError(
                f"{self.draws} draws give {self.draws + 1} ranks, which do not fill {self.bins} bins evenly.",
                key="draws",
                value=self.draws,
            )

    @property
    def key(self) -> str:
        """A digest that tells results of different plans apart."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()[:16]
