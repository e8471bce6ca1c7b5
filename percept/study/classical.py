"""Classical intervals of a study, in every kind asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Self

import numpy as np
import pandas as pd

from percept.inference.classical.intervals import interval_of
from percept.inference.classical.moments import Moments
from percept.inference.classical.trials import subject_means
from percept.inference.record import Interval
from percept.scene import Scene
from percept.sessions import Sessions
from percept.sessions.values import UNITS

#: Why a cell has no interval.
TOO_FEW = "it has fewer than two subjects"

#: Classical rows are always given in both families, the paper's first.
FAMILIES = ("normal", "lognormal")


@dataclasses.dataclass(frozen=True)
class Cell:
    """One parameter in one environment, one value per subject."""

    parameter: str  # Which
    environment: str  # Which
    moments: Moments | None  # Of the subjects' values, the mean of their trials on the family's scale
    why: str = ""  # Why there is none

    @classmethod
    def of(cls, parameter: str, environment: str, found: Moments | str) -> Self:
        """Make a cell of its moments, or of why there are none; without scatter there is no interval."""
        if isinstance(found, str):
            return cls(parameter, environment, None, found)
        if np.all(found.sd == 0):
            return cls(parameter, environment, None, "all subjects adjusted alike")
        return cls(parameter, environment, found)


def cell_moments(sessions: Sessions, parameters: tuple[str, ...], family: str) -> Iterator[Cell]:
    """Yield every cell of a study."""
    tables = list(sessions.table.groupby("environment", sort=False))
    for parameter in parameters:
        for environment, table in tables:
            yield Cell.of(parameter, str(environment), _moments(sessions, table, parameter, family))


def _moments(sessions: Sessions, table: pd.DataFrame, parameter: str, family: str) -> Moments | str:
    """Moments of one cell, or why there are none."""
    if sessions.form == "summary":
        row = table[table["parameter"] == parameter]
        if row.empty:
            return "it was not published"
        published = row.iloc[0]
        moments = Moments.from_limits(
            published["lower"], published["upper"], int(published["n"]), level=float(published["level"])
        )
        if family == "lognormal" and np.any(moments.mean <= 0):
            return "the published mean is zero or negative"
        return moments
    known = table[f"{parameter}_adj"].notna().to_numpy()
    adjusted = table[f"{parameter}_adj"].to_numpy(dtype=float)[known]
    subjects = table["subject"].to_numpy()[known]
    if len(set(subjects.tolist())) < 2:
        return TOO_FEW
    if family == "lognormal" and np.any(adjusted <= 0):
        return "a value is zero or negative"
    return subject_means(adjusted, subjects, family=family).moments()  # type: ignore[arg-type]


def cell_interval(
    moments: Moments, kind: str, family: str, scene: Scene, parameter: str, joint: str
) -> Interval:
    """Interval of one kind from moments, in N/m or N·s/m."""
    asked = scene.inference
    return interval_of(
        kind,  # type: ignore[arg-type]
        moments,
        level=asked.level,
        share=asked.held_share,
        confidence=asked.confidence,
        family=family,  # type: ignore[arg-type]
        joint=joint,  # type: ignore[arg-type]
        unit=UNITS[parameter],
    )
