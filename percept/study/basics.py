"""What all parts of a study share: what is left out, names, choices, random streams."""

from __future__ import annotations

import enum
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.record import Family
from percept.scene import InferenceTable, Scene
from percept.sessions import Sessions

Array = NDArray[np.float64]
#: By parameter and environment, in the parameter's unit; NaN where there is none.
References = Mapping[tuple[str, str], float]

#: Classical intervals are always given in both families, the paper's first.
FAMILIES: tuple[Family, ...] = ("normal", "lognormal")

#: Hint where environments have one subject each, as they have if each reference counts as one.
IF_BY_TRIAL = 'If references differ by trial, set [model] bias = "reference".'


def known(value: float) -> float | None:
    """Return a number, None in place of NaN."""
    return None if math.isnan(value) else float(value)


def claim_of(asked: InferenceTable) -> dict[str, Any]:
    """Return what the intervals of all kinds claim: level, share and confidence."""
    return {"level": asked.level, "share": asked.share, "confidence": asked.confidence}


def analysed_parameters(sessions: Sessions, scene: Scene) -> tuple[str, ...]:
    """Return the parameters that the scene names, or all that were adjusted."""
    present = sessions.parameters
    if not present:
        raise RefusalError("no adjusted value is left in the data.")
    asked = scene.inference.parameters or present
    if missing := sorted(set(asked) - set(present)):
        raise RefusalError(
            f"the scene asks for {sessions.quantities[missing[0]].label}, which no session has.",
            column=f"{missing[0]}_adj",
        )
    return tuple(p for p in present if p in asked)


def select(what: str, asked: str | Collection[str] | None, there: Sequence[str]) -> tuple[str, ...]:
    """Return the names asked for, if all are there."""
    if asked is None:
        return tuple(there)
    names = (asked,) if isinstance(asked, str) else tuple(asked)
    for name in names:
        if name not in there:
            raise UsageError(
                f"the study has no such {what}; there are {', '.join(there)}.", value=name
            )
    return names


@enum.unique
class Stream(enum.IntEnum):
    """What draws are for; two purposes with one number would share their draws."""

    LOCATIONS = 101
    USERS = 104
    NEW_ENVIRONMENT = 105
    CLASSICAL_BANDS = 107
    POSTERIOR_BANDS = 108
    PAIRS = 110
    FIDUCIAL = 111
    CONTRASTS = 114
    CHECKED_STATISTICS = 127
    PRIOR = 131
    DEVICES = 137


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """Return a new generator of a stream, independent of the sampler's."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))
