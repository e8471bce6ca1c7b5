"""Classical intervals of a study, in every kind asked for."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from percept.inference.classical.moments import Moments
from percept.inference.classical.sample_intervals import prediction_interval, t_interval, tolerance_interval
from percept.inference.classical.trials import subject_means
from percept.inference.intervals import Interval
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.units import UNITS

__all__ = ["FAMILIES", "cell_interval", "cell_moments"]

#: Classical rows are always given in both families, the paper's first.
FAMILIES = ("normal", "lognormal")


def cell_moments(
    sessions: Sessions, parameters: tuple[str, ...], family: str
) -> Iterator[tuple[str, str, Moments | None]]:
    """Yield parameter, environment and moments of every cell; None where the family does not fit.

    Parameters
    ----------
    sessions : Sessions
        The study, in either form.
    parameters : tuple of str
        "k", "b" or both.
    family : str
        "normal" or "lognormal".

    Yields
    ------
    parameter, environment : str
    moments : Moments or None
        One value per subject, the mean of their trials on the family's scale. None for lognormal
        where a value, or a published mean, is zero or negative.
    """
    for parameter in parameters:
        for environment, table in sessions.table.groupby("environment", sort=False):
            yield parameter, str(environment), _moments(sessions, table, parameter, family)


def _moments(sessions: Sessions, table: pd.DataFrame, parameter: str, family: str) -> Moments | None:
    if sessions.form == "summary":
        row = table[table["parameter"] == parameter]
        if row.empty:
            return None
        published = row.iloc[0]
        moments = Moments.from_limits(
            published["lower"], published["upper"], int(published["n"]), level=float(published["level"])
        )
        if family == "lognormal" and float(moments.mean) <= 0:
            return None
        return moments
    values = table[["subject", f"{parameter}_adj"]].dropna()
    adjusted = values[f"{parameter}_adj"].to_numpy(dtype=float)
    if family == "lognormal" and np.any(adjusted <= 0):
        return None
    return subject_means(adjusted, values["subject"].to_numpy(), family=family).moments()  # type: ignore[arg-type]


def cell_interval(
    moments: Moments, kind: str, family: str, scene: Scene, parameter: str, joint: str
) -> Interval:
    """Interval of one kind from moments, in N/m or N·s/m.

    Parameters
    ----------
    moments : Moments
        Of one cell.
    kind : str
        "mean", "user" or "share".
    family : str
        "normal" or "lognormal".
    scene : Scene
        Levels.
    parameter : str
        "k" or "b", for the unit.
    joint : str
        "marginal" or "bonferroni".

    Returns
    -------
    Interval
    """
    level, unit = scene.inference.level, UNITS[parameter]
    if kind == "mean":
        return t_interval(moments, level=level, family=family, joint=joint, unit=unit)  # type: ignore[arg-type]
    if kind == "user":
        return prediction_interval(moments, level=level, family=family, joint=joint, unit=unit)  # type: ignore[arg-type]
    return tolerance_interval(
        moments,
        level=level,
        share=scene.inference.held_share,
        confidence=scene.inference.confidence,
        family=family,  # type: ignore[arg-type]
        joint=joint,  # type: ignore[arg-type]
        unit=unit,
    )
