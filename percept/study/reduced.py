"""Intervals of studies larger than memory, from cells that blocks of their files were reduced to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from percept.errors import RefusalError, UsageError
from percept.inference.classical.moments import Moments
from percept.inference.hierarchy.statistics import from_cells
from percept.scene import Scene
from percept.sessions import Reduced
from percept.study.basics import References, analysed_parameters, results
from percept.study.fit import Prepared, bayesian_rows, fit_of, pooled, sampled
from percept.study.intervals import COLUMNS, TOO_FEW, Cell, classical_rows
from percept.study.responses import ResponseScale, decades, refuse_lone_subject


def reduced_intervals(reduced: Reduced, scene: Scene | None = None) -> pd.DataFrame:
    """Work out the intervals of a reduced study, as `Study.intervals` does, in one family."""
    scene = scene or Scene()
    if scene.study.factor:
        hint = "Read the files with read_sessions, or leave the key out to pool the levels."
        raise UsageError("a reduced study keeps no levels.", key="study.factor", hint=hint)
    references = reduced.references.set_index("environment")
    parameters = _parameters(reduced, scene)
    reference = {(p, str(e)): float(v) for p in parameters for e, v in references[f"{p}_ref"].items()}
    refuse_lone_subject(reduced.cells["subject"][reduced.cells["n"] > 0].unique().tolist())
    rows: list[dict[str, Any]] = []
    attrs: dict[str, Any] = {"skipped": (), "error_reached": ""}
    if scene.inference.method != "bayesian":
        cells = _cells(reduced, reference)
        rows += results(classical_rows({reduced.family: cells}, scene.inference, reference))
    if scene.inference.method != "classical":
        prepared = prepare_reduced(reduced, scene)
        found = fit_of(prepared, scene.inference, sampled(prepared.model, scene.inference))
        why = found.withheld
        if found.passed:
            rows += results(bayesian_rows(found, scene.inference, reference))
            attrs["error_reached"] = found.run.gate.error_reached
        elif rows:
            attrs["skipped"] = (("Bayesian intervals", why),)
        else:
            raise RefusalError(f"the Bayesian intervals are withheld: {why}")
    table = pd.DataFrame(rows, columns=COLUMNS)
    table.attrs |= attrs
    return table


def prepare_reduced(reduced: Reduced, scene: Scene) -> Prepared:
    """Build the hierarchical model of a study that was reduced while it was read."""
    parameters = _parameters(reduced, scene)
    cells = reduced.cells[reduced.cells["n"] > 0]
    subjects, present = tuple(cells["subject"].unique()), set(cells["environment"])
    environments = tuple(name for name in reduced.references["environment"] if name in present)
    refuse_lone_subject(subjects)
    columns = list(environments)
    grid = cells.pivot(index="subject", columns="environment").reindex(subjects)
    count = grid["n"][columns].fillna(0).to_numpy(dtype=np.intp)
    mean = np.stack([grid[f"mean_{p}"][columns].to_numpy() for p in parameters], axis=1)
    # One name, "kb", for either order of the parameters.
    order = list(reduced.quantities)
    pairs = [["scatter_" + "".join(sorted((p, q), key=order.index)) for q in parameters] for p in parameters]
    names_of_pairs = list(dict.fromkeys(pair for row in pairs for pair in row))
    sums = cells.groupby("environment")[names_of_pairs].sum().loc[columns]
    scatter = np.array([[sums[pair].to_numpy() for pair in row] for row in pairs])
    references = reduced.references.set_index("environment").loc[columns]
    reference = references[[f"{p}_ref" for p in parameters]].to_numpy().T
    names: Any = {"parameters": parameters, "environments": environments, "subjects": subjects}
    statistics = from_cells(count, mean, scatter, decades(reference), **names)
    return pooled(statistics, scene, reference, ResponseScale.of(reference, reduced.family))


def _parameters(reduced: Reduced, scene: Scene) -> tuple[str, ...]:
    """Parameters to be analysed, of a scene that fits the reduction."""
    if (family := scene.inference.family) != reduced.family:
        message = f"the trials were reduced to responses of the family {reduced.family!r}."
        hint = "Reduce them again, or change the scene."
        raise UsageError(message, key="inference.family", value=family, hint=hint)
    if scene.model.pooling == "none":
        message, hint = "cells that were reduced are pooled.", "Read the trials with read_sessions."
        raise UsageError(message, key="model.pooling", value="none", hint=hint)
    present = tuple(p for p in reduced.quantities if reduced.references[f"{p}_ref"].notna().any())
    return analysed_parameters(present, scene.inference.parameters, reduced.quantities)


def _cells(reduced: Reduced, reference: References) -> list[Cell]:
    """One value per subject, the mean of the trials on the family's scale, in its unit."""
    cells, log = reduced.cells[reduced.cells["n"] > 0], reduced.family == "lognormal"
    tables = dict(list(cells.groupby("environment", sort=False)))
    out: list[Cell] = []
    for p in dict.fromkeys(parameter for parameter, _ in reference):
        for environment in (e for e in reduced.references["environment"] if e in tables):
            table = tables[environment]
            mean, repeats = table[f"mean_{p}"].to_numpy(), bool((table["n"] > 1).any())
            values = reference[p, str(environment)] * (np.exp(mean) if log else 1.0 + mean)
            moments = Moments.from_values(values, log=log, repeats=repeats) if len(table) > 1 else TOO_FEW
            out.append(Cell.of(reduced.quantities[p], str(environment), moments))
    return out
