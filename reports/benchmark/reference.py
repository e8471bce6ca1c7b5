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
from typing import Self

import numpy as np

from percept.errors import RefusalError
from percept.results import plain
from reports.benchmark import designs
from reports.benchmark.simulated import published
from reports.fitted import by_percept
from reports.page import Page, say, store
from reports.studies import Array, Observed

#: Studies compared, and what each is. All but the published one are simulated.
STUDIES = {
    "published": "10 subjects, 5 environments, one trial; k and b",
    "published-k": "10 subjects, 5 environments, one trial; k alone",
    "24x12x3-weak": (
        "24 subjects, 12 environments, 3 trials; scatter between subjects a fifth of the trials'"
    ),
    "20x100x1": "20 subjects, 100 environments, one trial; k and b",
    "24x8-irregular": "24 subjects, 8 environments, 1 to 4 trials, a fifth of the cells missing",
    "two factors with interaction": "6 subjects, 2 environments, two factors",
    "subjects' own trial SDs": "6 subjects, 2 environments, a factor, 4 trials",
}
FILE = Path(__file__).with_name("reference.json")
TOLERANCE = 0.005  # Of each run: the pool's error is a fifth of that


def study_of(name: str) -> Observed:
    """Return one of the studies."""
    if name.startswith("published"):
        return published(("k",) if name == "published-k" else ("k", "b"))
    return designs.study_of(name, 1)


@dataclass(frozen=True, eq=False)
class Reference:
    """Limits of one study pooled over independent runs."""

    value: Array  # (2, 2, C)
    error: Array  # (2, 2, C)
    scatter: float  # SD of the runs over what each claims

    @classmethod
    def pooled(cls, rows: Sequence[dict[str, object]]) -> Self:
        """Pool runs of equal length, each a mapping with value and error."""
        values = np.array([row["value"] for row in rows])
        errors = np.array([row["error"] for row in rows])
        count = len(rows)
        value = values.mean(axis=0)
        claimed = np.sqrt((errors**2).mean(axis=0))
        squares = ((values - value) / claimed) ** 2
        scatter = math.sqrt(squares.sum() / ((count - 1) * value.size))
        return cls(value, claimed / math.sqrt(count), scatter)

    def relative_error(self, value: Array) -> float:
        """Return the root mean square error of limits (2, 2, C) over their half-widths."""
        half_width = 0.5 * (self.value[:, 1:] - self.value[:, :1])
        return float(np.sqrt(np.mean(((value - self.value) / half_width) ** 2)))


def stored_reference(study: str, file: Path = FILE) -> Reference:
    """Return the reference of one study; RefusalError where there is none."""
    references = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    if study not in references:
        raise RefusalError(
            "there are no reference limits of this study.",
            file=str(file),
            value=study,
            hint="Make them: python -m reports reference --out reports/benchmark.",
        )
    fields = references[study]
    value = np.array(fields["value"])
    return Reference(value, np.array(fields["error"]), fields["scatter"])


def page(out: Path, *, studies: tuple[str, ...] = tuple(STUDIES), runs: int = 30) -> Page:
    """Pool runs of studies, and write reference.json beside the page; an interrupted run goes on.

    Parameters
    ----------
    out : Path
        Folder that keeps the runs.
    studies : tuple of str
        Names that the benchmark knows.
    runs : int
        Of each study.

    Returns
    -------
    Page
    """
    file = out / FILE.name
    references = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    rows = []
    for study in studies:
        progress = partial(_say, study)
        kept = store(out, f"{study} {TOLERANCE}")
        found = Reference.pooled(kept.complete(partial(_run, study), runs, progress=progress))
        references[study] = plain(found)
        rows.append([study, found.scatter, found.relative_error(found.value + found.error)])
    file.write_text(json.dumps(references) + "\n", encoding="utf-8")
    page = Page(
        "Reference limits",
        f"{runs} independent runs of percept, each to an error of {TOLERANCE:.1%} of the"
        " half-width. `scatter` is their SD over what each claims, `error` that of their mean over"
        " the half-width.",
    )
    page.table(["study", "scatter", "error"], rows)
    return page


def _run(study: str, seed: int) -> dict[str, object]:
    return dict(plain(by_percept(study_of(study), TOLERANCE, seed)))


def _say(study: str, done: int, runs: int) -> None:
    say(f"{study}: {done} of {runs} runs done")
