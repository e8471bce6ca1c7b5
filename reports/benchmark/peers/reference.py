"""Reference limits that errors are measured against: independent runs of percept, pooled.

Their check is another density by another sampler: the page shows how far nutpie's limits lie from
them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from percept.errors import RefusalError
from percept.results.plain import plain
from reports.benchmark.measure import Printed
from reports.benchmark.peers.engines import STUDIES, Array, percept_run, study_of
from reports.command import say
from reports.store import store

if TYPE_CHECKING:
    from percept.study.prepare import Prepared


_FILE = "reference.json"
_RUNS = 30
_TOLERANCE = 0.005  # Of each run: the pool's error is a fifth of that


@dataclass(frozen=True, eq=False)
class Reference:
    """Limits of one study pooled over independent runs."""

    value: Array  # (3, 2, C)
    error: Array  # (3, 2, C)
    effective: float  # Effective draws of the slowest quantity, over all runs
    runs: int  # Runs pooled
    scatter: float  # SD of the runs over what each claims

    @classmethod
    def pooled(cls, rows: Sequence[Printed]) -> Self:
        """Pool runs of equal length, each a mapping with value, error and effective."""
        values = np.array([row["value"] for row in rows])
        errors = np.array([row["error"] for row in rows])
        count = len(rows)
        value = values.mean(axis=0)
        claimed = np.sqrt((errors**2).mean(axis=0))
        effective = sum(row["effective"] for row in rows)
        scatter = math.nan
        if count > 1:
            squares = ((values - value) / claimed) ** 2
            scatter = math.sqrt(squares.sum() / ((count - 1) * value.size))
        return cls(value, claimed / math.sqrt(count), effective, count, scatter)

    @property
    def half_width(self) -> Array:
        """Half-widths of the intervals, shape (3, 1, C)."""
        return 0.5 * (self.value[:, 1:] - self.value[:, :1])

    def relative_error(self, value: Array) -> float:
        """Return the root mean square error of limits (3, 2, C) over their half-widths."""
        relative = (value - self.value) / self.half_width
        return float(np.sqrt(np.mean(relative**2)))


def stored_references(folder: str | Path) -> dict[str, Reference]:
    """Return the references that a folder keeps, by study; none where it has no file of them."""
    path = Path(folder) / _FILE
    references: dict[str, Reference] = {}
    if not path.is_file():
        return references
    for study, fields in json.loads(path.read_text(encoding="utf-8")).items():
        value = np.array(fields.pop("value"))
        error = np.array(fields.pop("error"))
        references[study] = Reference(value, error, **fields)
    return references


def stored_reference(folder: str | Path, study: str) -> Reference:
    """Return the reference of one study; RefusalError where there is none."""
    references = stored_references(folder)
    if study not in references:
        raise RefusalError(
            f"{Path(folder) / _FILE} has no reference limits of this study.",
            key="--rows",
            value=study,
            hint="Copy reports/benchmark/reference.json of the repository there,"
            " or make them: python -m reports.benchmark reference --rows STUDY --out DIR.",
        )
    return references[study]


def make_references(
    out: str | Path,
    studies: Sequence[str] = (),
    *,
    runs: int = _RUNS,
) -> Path:
    """Pool runs of studies beside the stored references; an interrupted call goes on.

    Parameters
    ----------
    out : str or Path
        Folder that keeps runs and references.
    studies : sequence of str, optional
        Of `STUDIES`; all by default.
    runs : int
        Of each study.

    Returns
    -------
    Path
        The references, in the form percept stores them in.
    """
    folder = Path(out)
    references = stored_references(folder)
    for study in studies or STUDIES:
        run = partial(_run, study_of(study))
        kept = store(folder, f"{study} {_TOLERANCE}")
        progress = partial(_say, study)
        references[study] = Reference.pooled(kept.complete(run, runs, progress=progress))
    (folder / _FILE).write_text(json.dumps(plain(references)) + "\n", encoding="utf-8")
    return folder / _FILE


def _run(study: Prepared, seed: int) -> Printed:
    return dict(plain(percept_run(study, _TOLERANCE, seed)))


def _say(study: str, done: int, runs: int) -> None:
    say(f"{study}: {done} of {runs} runs done")
