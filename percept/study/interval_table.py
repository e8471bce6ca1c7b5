"""The table of intervals: one row per method, kind, family and joint treatment."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pandas as pd

from percept.errors import RefusalError
from percept.inference.intervals import Interval
from percept.study.classical import FAMILIES, cell_interval, cell_moments
from percept.study.responses import refuse_lone_subject
from percept.study.units import NAMES, UNITS

if TYPE_CHECKING:
    from percept.study.bayesian import Fit
    from percept.study.study import Study

__all__ = ["interval_table"]

_COLUMNS = (
    "environment", "parameter", "kind", "method", "family", "joint", "level", "share", "confidence",
    "lower", "upper", "estimate", "n", "unit", "reference", "covers",
)  # fmt: skip


def interval_table(study: Study) -> pd.DataFrame:
    """Put the intervals of the methods asked for into one table.

    Parameters
    ----------
    study : Study
        Fitted now, unless only the classical method is asked for.

    Returns
    -------
    DataFrame
        One row per interval: environment, what `Interval.as_dict` holds, and the reference; limits and
        references in N/m and N·s/m. No Bayesian rows where the gate failed.

    Raises
    ------
    RefusalError
        Fewer than two subjects; nothing that has scatter; and as the fit.
    """
    rows = []
    if study.scene.inference.method != "bayesian":
        rows += list(_classical(study))
    if study.fit is not None and study.fit.run.gate.passed:
        rows += list(_bayesian(study, study.fit))
    if not rows and study.scene.inference.method == "classical":
        cell = next(iter(cell_moments(study.sessions, study.parameters, FAMILIES[0])))
        raise RefusalError(
            f"there is no interval of anything: {NAMES[cell.parameter]} in {cell.environment}, say, where "
            f"{cell.why}."
        )
    return pd.DataFrame(rows, columns=list(_COLUMNS))


def _classical(study: Study) -> Iterator[dict[str, Any]]:
    if study.sessions.form != "summary":
        refuse_lone_subject(study.sessions.table["subject"].unique().tolist())
    joints = ("marginal", "bonferroni") if len(study.parameters) == 2 else ("marginal",)
    for family in FAMILIES:
        for cell in cell_moments(study.sessions, study.parameters, family):
            if cell.moments is None:
                continue
            for kind in study.scene.inference.kinds:
                for joint in joints:
                    interval = cell_interval(cell.moments, kind, family, study.scene, cell.parameter, joint)
                    yield _row(study, interval, cell.parameter, cell.environment)


def _bayesian(study: Study, fit: Fit) -> Iterator[dict[str, Any]]:
    asked = study.scene.inference
    for kind, (lower, upper) in fit.limits.items():
        for c, (parameter, environment) in enumerate(fit.prepared.model.cells):
            interval = Interval(
                kind=kind,  # type: ignore[arg-type]
                method="bayesian",
                family=asked.family,
                level=asked.level,
                lower=float(lower[c]),
                upper=float(upper[c]),
                estimate=float(fit.estimate[c]),
                n=int(fit.prepared.counts[c]),
                share=asked.held_share if kind == "share" else None,
                confidence=asked.confidence if kind == "share" else None,
                repeats=fit.prepared.repeats,
                approximate=study.sessions.form == "summary" and asked.family == "lognormal",
                unit=UNITS[parameter],
            )
            yield _row(study, interval, parameter, environment)


def _row(study: Study, interval: Interval, parameter: str, environment: str) -> dict[str, Any]:
    return {
        "environment": environment,
        "parameter": parameter,
        "reference": study.reference[parameter, environment],
        **interval.as_dict(),
    }
