"""The table of intervals: one row per method, kind, family and joint treatment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import pandas as pd

from percept.errors import RefusalError
from percept.inference.record import Interval
from percept.scene import Scene
from percept.sessions.values import UNITS
from percept.study.classical import FAMILIES, Cell, cell_interval, cell_moments
from percept.study.placed import References
from percept.study.responses import refuse_lone_subject
from percept.study.units import NAMES

if TYPE_CHECKING:
    from percept.study.bayesian import Fit
    from percept.study.study import Study

COLUMNS = [
    "environment", "parameter", "kind", "method", "family", "joint", "level", "share", "confidence",
    "lower", "upper", "estimate", "n", "unit", "reference", "covers",
]  # fmt: skip


def interval_table(study: Study) -> pd.DataFrame:
    """Put the intervals of the methods asked for into one table."""
    asked, form = study.scene.inference, study.sessions.form
    rows: list[dict[str, Any]] = []
    if asked.method != "bayesian":
        if form != "summary":
            refuse_lone_subject(study.sessions.table["subject"].unique().tolist())
        cells = {f: list(cell_moments(study.sessions, study.parameters, f)) for f in FAMILIES}
        rows += classical_rows(cells, study.scene, study.reference)
    if study.fit is not None and study.fit.run.gate.passed:
        approximate = form == "summary" and asked.family == "lognormal"
        rows += bayesian_rows(study.fit, study.scene, study.reference, approximate=approximate)
    if not rows and asked.method == "classical":
        refuse_nothing(cells[FAMILIES[0]])
    return pd.DataFrame(rows, columns=COLUMNS)


def refuse_nothing(cells: Sequence[Cell]) -> NoReturn:
    """Refuse a study whose cells have no interval, naming the first of them."""
    cell = cells[0]
    raise RefusalError(
        f"there is no interval of anything: {NAMES[cell.parameter]} in {cell.environment}, say, where "
        f"{cell.why}."
    )


def classical_rows(
    cells: Mapping[str, Sequence[Cell]], scene: Scene, reference: References
) -> Iterator[dict[str, Any]]:
    """Yield a row for every classical interval the scene asks for."""
    for family, found in cells.items():
        two = len({cell.parameter for cell in found}) == 2
        for cell in found:
            if cell.moments is None:
                continue
            for kind in scene.inference.kinds:
                for joint in ("marginal", "bonferroni") if two else ("marginal",):
                    interval = cell_interval(cell.moments, kind, family, scene, cell.parameter, joint)
                    yield _row(interval, cell.parameter, cell.environment, reference)


def bayesian_rows(
    fit: Fit, scene: Scene, reference: References, *, approximate: bool = False
) -> Iterator[dict[str, Any]]:
    """Yield a row for every interval of a fit."""
    asked = scene.inference
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
                approximate=approximate,
                unit=UNITS[parameter],
            )
            yield _row(interval, parameter, environment, reference)


def _row(interval: Interval, parameter: str, environment: str, reference: References) -> dict[str, Any]:
    return {
        "environment": environment,
        "parameter": parameter,
        "reference": reference[parameter, environment],
        **interval.as_dict(),
    }
