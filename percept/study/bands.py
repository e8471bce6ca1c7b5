"""Bands of a study's intervals against the impedance of its environments."""

from __future__ import annotations

import numpy as np
import pandas as pd

from percept.boundary.band import (
    BandLaw,
    BandStatement,
    BandStudy,
    band_laws,
    band_statements,
    environment_magnitude_range,
)
from percept.study.band_replicates import Replicates
from percept.study.bayesian import Fit
from percept.study.cells import paired_limits
from percept.study.placed import FEWEST
from percept.study.posterior import thinned_points


def band_study(
    intervals: pd.DataFrame,
    environments: tuple[str, ...],
    replicates: Replicates,
    *,
    omega: float,
    level: float,
    kappa: pd.DataFrame | None = None,
) -> BandStudy:
    """Band of abs(Z_e) over each environment's rectangle of intervals, and the laws bands follow."""
    table = pd.DataFrame(_rows(intervals[intervals["environment"].isin(environments)], omega))
    laws: list[BandLaw] = []
    statements: list[BandStatement] = []
    for found, part in table.groupby(["method", "kind", "family"], sort=False) if len(table) else ():
        method, kind, family = (str(label) for label in found)
        redrawn = replicates.get((method, kind, family))
        impedance, bands = part["impedance"].to_numpy(), part["band"].to_numpy()
        names = tuple(part["environment"])
        if redrawn is None or names != redrawn.environments or len(names) < FEWEST:
            continue
        drawn = redrawn.bands
        # Draws of a posterior have laws of their own; a bootstrap's scatter about that of the study's bands.
        fitted = None if method == "bayesian" else bands
        laws += band_laws(
            names, impedance, fitted, drawn, method=method, kind=kind, family=family, level=level
        )
        statements += band_statements(impedance, drawn, method=method, kind=kind, family=family)
    return BandStudy(omega, table, tuple(laws), tuple(statements), kappa)


def weber_trend(fit: Fit, *, level: float) -> pd.DataFrame | None:
    """Give the trend of log spread per decade of the reference, which Weber's law sets to zero."""
    named = fit.prepared.model.scales(thinned_points(fit)[0])
    if "kappa" not in named:
        return None
    drawn = named["kappa"][1]
    ends = np.quantile(drawn, [0.5 * (1.0 - level), 0.5 * (1.0 + level)], axis=0)
    return pd.DataFrame(
        {
            "parameter": list(dict.fromkeys(p for p, _ in fit.prepared.model.cells)),
            "lower": ends[0],
            "value": drawn.mean(axis=0),
            "upper": ends[1],
            "below_zero": (drawn < 0).mean(axis=0),
        }
    )


def _rows(intervals: pd.DataFrame, omega: float) -> list[dict[str, object]]:
    labels = ("environment", "method", "kind", "family")
    rows: list[dict[str, object]] = []
    for cell, limits in paired_limits(intervals[intervals["joint"] == "marginal"], labels):
        lower, upper = (float(end) for end in environment_magnitude_range(omega, *limits))
        k_ref, b_ref = (float(cell[p]["reference"]) for p in ("k", "b"))
        impedance = float(np.hypot(b_ref, k_ref / omega))
        rows.append(
            {
                **{label: cell["k"][label] for label in labels},
                "impedance": impedance,
                "lower": lower,
                "upper": upper,
                "band": upper - lower,
                "relative": (upper - lower) / impedance,
            }
        )
    return rows
