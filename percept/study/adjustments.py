"""What was adjusted: how often by whom, and environment by environment each subject's value, mean and SD."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from percept.inference.classical.trials import subject_means
from percept.sessions import Sessions
from percept.sessions.values import UNITS


def adjustments(sessions: Sessions) -> Iterator[dict[str, Any]]:
    """Describe the adjustments as they are, on no scale and of no model."""
    if sessions.form != "trials":
        return
    for environment, rows in sessions.table.groupby("environment", sort=False):
        for parameter in sessions.parameters:
            known = rows[rows[f"{parameter}_adj"].notna()]
            cell = {"environment": str(environment), "parameter": parameter}
            reference = float(rows[f"{parameter}_ref"].iloc[0])
            if known.empty:
                yield _described(cell, reference, [], None, None)
                continue
            means = subject_means(
                known[f"{parameter}_adj"].to_numpy(dtype=float), known["subject"].to_numpy()
            )
            values = means.values.tolist()
            if len(values) == 1:
                yield _described(cell, reference, values, values[0], None)
                continue
            moments = means.moments()
            yield _described(cell, reference, values, float(moments.mean), float(moments.sd))


def design_counts(sessions: Sessions) -> dict[str, Any] | None:
    """Count trials, sessions and cells."""
    if sessions.form != "trials":
        return None
    table = sessions.table
    trials = table.groupby(["subject", "environment"], sort=False).size()
    visits = table.groupby("subject", sort=False)["session"].nunique()
    cells = len(sessions.subjects) * len(sessions.environments)
    return {
        "cells": cells,
        "missing": cells - len(trials),
        "trials": [int(trials.min()), int(trials.max())],
        "sessions": [int(visits.min()), int(visits.max())],
    }


def _described(
    cell: dict[str, str], reference: float, values: list[float], mean: float | None, sd: float | None
) -> dict[str, Any]:
    return {
        **cell, "reference": reference, "n": len(values), "mean": mean, "sd": sd, "values": values,
        "unit": UNITS[cell["parameter"]],
    }  # fmt: skip
