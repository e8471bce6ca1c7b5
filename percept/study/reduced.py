"""Intervals of studies larger than memory, from cells that blocks of their files were reduced to."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from percept.errors import RefusalError, UsageError
from percept.inference.classical.moments import Moments
from percept.inference.hierarchy.statistics import from_cells
from percept.scene import Scene
from percept.sessions import Reduced
from percept.study.basics import References, analysed_parameters, results
from percept.study.fit import Prepared, bayesian_rows, fit_of, pooled, sampled
from percept.study.intervals import COLUMNS, TOO_FEW, Cell, Row, classical_rows
from percept.study.responses import ResponseScale, decades, refuse_lone_subject

__all__ = ["prepare_reduced", "reduced_intervals"]


def reduced_intervals(reduced: Reduced, scene: Scene | None = None) -> pd.DataFrame:
    """Work out the intervals of a reduced study, as `Study.intervals` does, in one family."""
    scene = scene or Scene()
    if scene.study.factor:
        hint = "Read the files with read_sessions, or leave the key out to pool the levels."
        raise UsageError("a reduced study keeps no levels.", key="study.factor", hint=hint)
    asked = scene.inference
    parameters = _parameters(reduced, scene)
    shown = reduced.references.set_index("environment")
    reference = {(p, str(e)): float(v) for p in parameters for e, v in shown[f"{p}_ref"].items()}
    cells = reduced.cells[reduced.cells["n"] > 0]
    refuse_lone_subject(cells["subject"].unique().tolist())
    rows: list[Row] = []
    attrs: dict[str, object] = {"skipped": (), "error_reached": ""}
    if asked.method != "bayesian":
        moments = list(_cells(reduced, cells, reference))
        rows += results(
            classical_rows({reduced.family: moments}, asked, reference, users=scene.user_noun)
        )
    if asked.method != "classical":
        prepared = prepare_reduced(reduced, scene)
        found = fit_of(prepared, asked, sampled(prepared.model, asked))
        if found.passed:
            rows += results(bayesian_rows(found, asked, reference, scene.user_noun))
            attrs["error_reached"] = found.run.gate.error_reached
        elif rows:
            attrs["skipped"] = (("Bayesian intervals", found.withheld),)
        else:
            raise RefusalError(f"the Bayesian intervals are withheld: {found.withheld}")
    table = pd.DataFrame(rows, columns=COLUMNS)
    table.attrs |= attrs
    return table


def prepare_reduced(reduced: Reduced, scene: Scene) -> Prepared:
    """Build the hierarchical model of a study that was reduced while it was read."""
    parameters = _parameters(reduced, scene)
    cells = reduced.cells[reduced.cells["n"] > 0]
    subjects = tuple(cells["subject"].unique())
    present = set(cells["environment"])
    refuse_lone_subject(subjects)
    environments = tuple(name for name in reduced.references["environment"] if name in present)
    columns = list(environments)
    grid = cells.pivot(index="subject", columns="environment").reindex(subjects)
    count = grid["n"][columns].fillna(0).to_numpy(dtype=np.intp)
    mean = np.stack([grid[f"mean_{p}"][columns].to_numpy() for p in parameters], axis=1)
    # One name, "kb", for either order of the parameters.
    order = list(reduced.quantities)
    scatter = np.empty((len(parameters), len(parameters), len(columns)))
    by_environment = cells.groupby("environment")
    for i, p in enumerate(parameters):
        for j, q in enumerate(parameters):
            pair = "".join(sorted((p, q), key=order.index))
            sums = by_environment[f"scatter_{pair}"].sum()
            scatter[i, j] = sums.loc[columns].to_numpy()
    by_name = reduced.references.set_index("environment")
    reference = by_name.loc[columns, [f"{p}_ref" for p in parameters]].to_numpy().T
    statistics = from_cells(
        count,
        mean,
        scatter,
        decades(reference),
        parameters=parameters,
        environments=environments,
        subjects=subjects,
    )
    scale = ResponseScale.of(reference, reduced.family)
    return pooled(statistics, scene, reference, scale)


def _parameters(reduced: Reduced, scene: Scene) -> tuple[str, ...]:
    """Parameters to be analysed, of a scene that fits the reduction."""
    reduced.options.require(scene)
    if (family := scene.inference.family) != reduced.family:
        message = f"the trials were reduced to responses of the family {reduced.family!r}."
        hint = "Reduce them again, or change the scene."
        raise UsageError(message, key="inference.family", value=family, hint=hint)
    if scene.model.pooling == "none":
        message = "cells that were reduced are pooled."
        hint = "Read the trials with read_sessions."
        raise UsageError(message, key="model.pooling", value="none", hint=hint)
    present = tuple(p for p in reduced.quantities if reduced.references[f"{p}_ref"].notna().any())
    return analysed_parameters(present, scene.inference.parameters, reduced.quantities)


def _cells(reduced: Reduced, cells: pd.DataFrame, reference: References) -> Iterator[Cell]:
    """Yield one value per subject, the mean of the trials on the family's scale, in its unit."""
    log = reduced.family == "lognormal"
    tables = dict(list(cells.groupby("environment", sort=False)))
    for (p, environment), shown in reference.items():
        if (table := tables.get(environment)) is None:
            continue
        mean = table[f"mean_{p}"].to_numpy()
        repeats = bool((table["n"] > 1).any())
        values = shown * (np.exp(mean) if log else 1.0 + mean)
        moments: Moments | str = TOO_FEW
        if len(table) > 1:
            moments = Moments.from_values(values, log=log, repeats=repeats)
        yield Cell.of(reduced.quantities[p], environment, moments)
