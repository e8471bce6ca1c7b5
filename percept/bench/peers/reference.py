"""Reference limits that errors are measured against: independent runs of percept, pooled.

Their check is another density by another sampler: the page shows how far nutpie's limits lie from
them.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any, Self

import numpy as np

from percept.bench.peers.engines import STUDIES, Array, percept_run, study_statistics
from percept.calibration.studies import Checkpoint
from percept.errors import RefusalError
from percept.results.plain import plain

FILE = "reference.json"
_RUNS, _TOLERANCE = 30, 0.005


@dataclasses.dataclass(frozen=True, eq=False)
class Reference:
    """Limits of one study pooled over independent runs."""

    value: Array  # (3, 2, C)
    error: Array  # (3, 2, C)
    effective: float  # Effective draws of the slowest quantity, over all runs
    runs: int  # Runs pooled
    scatter: float  # SD of the runs over what each claims

    @classmethod
    def pooled(cls, rows: list[dict[str, Any]]) -> Self:
        """Pool runs of equal length, each a mapping with value, error and effective."""
        values = np.array([row["value"] for row in rows])
        errors = np.array([row["error"] for row in rows])
        count = len(rows)
        value, claimed = values.mean(axis=0), np.sqrt((errors**2).mean(axis=0))
        spread = (values - value) / claimed
        scatter = (
            math.sqrt((spread**2).sum() / ((count - 1) * value.size)) if count > 1 else math.nan
        )
        effective = sum(row["effective"] for row in rows)
        return cls(value, claimed / math.sqrt(count), effective, count, scatter)

    @property
    def half_width(self) -> Array:
        """Half-widths of the intervals, shape (3, 1, C)."""
        return 0.5 * (self.value[:, 1:] - self.value[:, :1])

    def relative_error(self, value: Array) -> float:
        """Root mean square error of limits (3, 2, C) over their half-widths."""
        return float(np.sqrt(np.mean(((value - self.value) / self.half_width) ** 2)))


def stored_references() -> dict[str, Reference]:
    """Return the references that come with percept, by study."""
    text = resources.files("percept.bench.peers").joinpath(FILE).read_text(encoding="utf-8")
    return {
        study: Reference(**(kept | {name: np.array(kept[name]) for name in ("value", "error")}))
        for study, kept in json.loads(text).items()
    }


def stored_reference(study: str) -> Reference:
    """Return the reference of one study."""
    found = stored_references()
    if study not in found:
        raise RefusalError(
            f"no reference limits are stored; there are some for {', '.join(found)}.",
            key="--rows",
            value=study,
            hint="Make them: percept bench reference --rows STUDY --out DIR.",
        )
    return found[study]


def make_references(
    out: str | Path,
    studies: tuple[str, ...] = (),
    *,
    runs: int = _RUNS,
    log: Callable[[str], None] = lambda line: None,
) -> Path:
    """Pool runs of each study beside the stored references; an interrupted call goes on."""
    folder = Path(out)
    found = stored_references()
    for study in studies or STUDIES:
        statistics = study_statistics(study)

        def run(seed: int, study: str = study, statistics: Any = statistics) -> dict[str, Any]:
            log(f"{study}: run {seed + 1} of {runs}")
            return dict(plain(percept_run(statistics, _TOLERANCE, seed)))

        kept = Checkpoint(folder / "runs.jsonl", f"{study} {_TOLERANCE}", what="reference")
        found[study] = Reference.pooled(kept.complete(run, runs))
    (folder / FILE).write_text(json.dumps(plain(found)) + "\n", encoding="utf-8")
    return folder / FILE
