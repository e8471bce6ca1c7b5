"""Intervals of studies larger than memory, from cells that blocks of their files were reduced to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.classical.moments import Moments
from percept.inference.hierarchy.statistics import from_cells
from percept.inference.sampling.run import Progress
from percept.scene import Scene
from percept.sessions import Reduced
from percept.study.bayesian import Prepared, RunStore, fit, pooled
from percept.study.chosen import analysed
from percept.study.classical import TOO_FEW, Cell
from percept.study.interval_table import COLUMNS, bayesian_rows, classical_rows, refuse_nothing
from percept.study.placed import References
from percept.study.responses import ResponseScale, decades, refuse_lone_subject

Array = NDArray[np.float64]


def reduced_intervals(
    reduced: Reduced,
    scene: Scene | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    store: RunStore | None = None,
) -> pd.DataFrame:
    """Work out the intervals of a study that was reduced while it was read."""
    scene = scene or Scene()
    parameters = _asked(reduced, scene)
    reference = {
        (p, str(e)): float(value)
        for p in parameters
        for e, value in zip(reduced.references["environment"], reduced.references[f"{p}_ref"], strict=True)
    }
    refuse_lone_subject(reduced.cells["subject"][reduced.cells["n"] > 0].unique().tolist())
    rows: list[dict[str, Any]] = []
    skipped: tuple[tuple[str, str], ...] = ()
    error_reached = ""
    if scene.inference.method != "bayesian":
        cells = _cells(reduced, reference)
        rows += classical_rows({reduced.family: cells}, scene, reference)
        if not rows and scene.inference.method == "classical":
            refuse_nothing(cells)
    if scene.inference.method != "classical":
        found = fit(prepare_reduced(reduced, scene), scene, progress=progress, store=store)
        why = " ".join(found.run.gate.reasons)
        if found.run.gate.passed:
            rows += bayesian_rows(found, scene, reference)
            error_reached = found.run.gate.error_reached
        elif rows:
            skipped = (("Bayesian intervals", why),)
        else:
            raise RefusalError(f"the Bayesian intervals are withheld: {why}")
    table = pd.DataFrame(rows, columns=COLUMNS)
    table.attrs |= {"skipped": skipped, "error_reached": error_reached}
    return table


def prepare_reduced(reduced: Reduced, scene: Scene) -> Prepared:
    """Build the hierarchical model of a study that was reduced while it was read."""
    parameters = _asked(reduced, scene)
    cells = reduced.cells[reduced.cells["n"] > 0]
    subjects = tuple(dict.fromkeys(cells["subject"]))
    environments = tuple(dict.fromkeys(cells["environment"]))
    refuse_lone_subject(subjects)
    at = (
        pd.Index(subjects).get_indexer(cells["subject"]),
        pd.Index(environments).get_indexer(cells["environment"]),
    )
    count = np.zeros((len(subjects), len(environments)), dtype=np.intp)
    count[at] = cells["n"]
    size = len(parameters)
    mean = np.full((len(subjects), size, len(environments)), np.nan)
    scatter = np.zeros((size, size, len(environments)))
    for i, p in enumerate(parameters):
        mean[at[0], i, at[1]] = cells[f"mean_{p}"]
        for j, q in enumerate(parameters):
            pair = "".join(sorted((p, q), reverse=True))
            np.add.at(scatter[i, j], at[1], cells[f"scatter_{pair}"].to_numpy())
    columns = [f"{p}_ref" for p in parameters]
    reference = reduced.references.set_index("environment").loc[list(environments), columns].to_numpy().T
    statistics = from_cells(
        count, mean, scatter, decades(reference),
        parameters=parameters, environments=environments, subjects=subjects,
    )  # fmt: skip
    return pooled(statistics, scene, reference, ResponseScale.of(reference, reduced.family))


def _asked(reduced: Reduced, scene: Scene) -> tuple[str, ...]:
    """Parameters to be analysed, of a scene that fits the reduction."""
    if scene.inference.family != reduced.family:
        raise UsageError(
            f"the trials were reduced to responses of the family {reduced.family!r}.",
            key="inference.family",
            value=scene.inference.family,
            hint="Reduce them anew, or change the scene.",
        )
    if scene.model.pooling == "none":
        raise UsageError(
            "cells that were reduced are pooled.", key="model.pooling", value="none",
            hint="Read the trials with read_sessions.",
        )  # fmt: skip
    present = tuple(p for p in ("k", "b") if reduced.references[f"{p}_ref"].notna().any())
    return analysed(present, scene)


def _cells(reduced: Reduced, reference: References) -> list[Cell]:
    """One value per subject, the mean of the trials on the family's scale, in N/m or N·s/m."""
    cells = reduced.cells[reduced.cells["n"] > 0]
    log = reduced.family == "lognormal"
    return [
        Cell.of(p, str(environment), _moments(table, p, reference[p, str(environment)], log))
        for p in dict.fromkeys(parameter for parameter, _ in reference)
        for environment, table in cells.groupby("environment", sort=False)
    ]


def _moments(table: pd.DataFrame, parameter: str, reference: float, log: bool) -> Moments | str:
    if len(table) < 2:
        return TOO_FEW
    mean = table[f"mean_{parameter}"].to_numpy()
    values = reference * (np.exp(mean) if log else 1.0 + mean)
    return Moments.from_values(values, log=log, repeats=bool((table["n"] > 1).any()))
