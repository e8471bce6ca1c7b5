"""What each subject did, over all environments: of no model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.results import SubjectRow
from percept.scene import Scene
from percept.sessions import Sessions

__all__ = ["subject_rows"]

FloatArray = NDArray[np.float64]

#: Others whose scatter a distance is measured in: one alone has none.
_FEWEST_OTHERS = 2


def subject_rows(sessions: Sessions, scene: Scene) -> Iterator[SubjectRow]:
    """Describe what every subject adjusted; none of published limits.

    Parameters
    ----------
    sessions : Sessions
        What was read.
    scene : Scene
        Its family decides how deviations from references are measured: as logarithms of ratios
        (lognormal), as relative deviations (normal), or as differences where a reference is not
        positive. Logarithms give way to relative deviations where a value has none.

    Yields
    ------
    SubjectRow
        By quantity, and by subject in the order of the sessions.
    """
    if sessions.form != "trials":
        return
    for parameter in sessions.parameters:
        columns = [f"{parameter}_ref", f"{parameter}_adj"]
        rows = sessions.table.dropna(subset=columns)
        reference = rows[columns[0]].to_numpy(dtype=float)
        adjusted = rows[columns[1]].to_numpy(dtype=float)
        relative = bool((reference > 0).all())
        log = relative and scene.inference.family == "lognormal" and bool((adjusted > 0).all())
        if log:
            deviations = np.log(adjusted / reference)
        elif relative:
            deviations = adjusted / reference - 1.0
        else:
            deviations = adjusted - reference
        trials = rows.assign(deviation=deviations).groupby(["subject", "environment"], sort=False)
        cells = trials["deviation"].mean().unstack()
        distances = dict(zip(cells.index, _distances(cells), strict=True))
        for subject in sessions.subjects:
            if subject not in distances:
                continue
            values = cells.loc[subject].dropna().to_numpy(dtype=float)
            mean = float(values.mean())
            yield SubjectRow(
                subject=subject,
                parameter=parameter,
                n=len(values),
                trials=int((rows["subject"] == subject).sum()),
                relative=relative,
                log=log,
                mean=float(np.expm1(mean)) if log else mean,
                sd=float(values.std(ddof=1)) if len(values) > 1 else None,
                distance=distances[subject],
                unit="" if relative else sessions.quantities[parameter].unit,
            )


def _distances(cells: pd.DataFrame) -> list[float | None]:
    """Return how far each subject lies from the others' mean, in the others' SDs.

    `cells` has a row per subject and a column per environment, NaN where one did not take part.
    Environments are centred first, so that subjects with different environments compare.
    """
    centred = cells - cells.mean()
    own: FloatArray = centred.mean(axis=1).to_numpy(dtype=float)
    distances: list[float | None] = []
    for position, value in enumerate(own):
        others = np.delete(own, position)
        scatter = float(others.std(ddof=1)) if len(others) >= _FEWEST_OTHERS else 0.0
        distances.append(float((value - others.mean()) / scatter) if scatter > 0.0 else None)
    return distances
