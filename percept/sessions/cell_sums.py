"""A study's cells summed up block by block: counts, means and scatters, and the checks over all of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import RefusalError, UsageError
from percept.sessions.checks import (
    drop_unfinished,
    look_alikes,
    refuse_twin,
    repeats_over_sessions,
    unit_doubt,
    units_of_scene,
)
from percept.sessions.numbering import Registry, codes_of, distinct, grown
from percept.sessions.options import IDS, ReadOptions
from percept.sessions.part import Part
from percept.sessions.read import never_named
from percept.sessions.records import Notice, Source

_TRIALS = 1 << 31
# Three numbers share 63 bits: two million ids of each kind.
_BITS = 21
_ID = (1 << _BITS) - 1
_Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reduced:
    """Sufficient statistics of a study's responses.

    Attributes
    ----------
    cells : DataFrame
        One row per subject and environment, in order of first appearance: `subject`, `environment`, `n`
        (trials with every parameter), `mean_k`, `mean_b` (mean response, unit-free), and the sums of
        squares and products about the means `scatter_kk`, `scatter_kb`, `scatter_bb`. Columns of a
        parameter that was not measured are NaN.
    references : DataFrame
        `environment`, `k_ref` (N/m), `b_ref` (N·s/m).
    family : {"lognormal", "normal"}
        A response is log(adjusted/reference), or (adjusted − reference)/reference.
    sources : tuple of Source
    notices : tuple of Notice
    counts : mapping of str to int
        Rows by what became of them.
    """

    cells: pd.DataFrame
    references: pd.DataFrame
    family: Literal["lognormal", "normal"]
    sources: tuple[Source, ...] = ()
    notices: tuple[Notice, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)


class CellSums:
    """Accumulators over blocks: means and scatters, the trials seen, the references."""

    def __init__(self, family: str, options: ReadOptions) -> None:
        self.family = family
        self.options = options
        self.subjects, self.sessions, self.environments = Registry(), Registry(), Registry()
        self.cells, self.visits = Registry(), Registry()
        self.sources: list[Source] = []
        self.notices: list[Notice] = []
        self.counts: Counter[str] = Counter()
        self.parameters: Sequence[str] = []
        # Visits × trials: whether the trial was seen.
        self.seen = np.zeros((0, 0), dtype=np.bool_)
        self.references = {p: np.zeros(0) for p in ("k", "b")}
        self.declared_units: set[str] = set()
        # Rows of a cell, and of these the trials with every parameter.
        self.rows = np.zeros(0, dtype=np.int64)
        self.n = np.zeros(0)
        self.means = np.zeros((2, 0))
        self.scatters = np.zeros((3, 0))

    def measure(self, parameters: set[str], file: str) -> None:
        """Hold every file to the same parameters."""
        ordered = [p for p in ("k", "b") if p in parameters]
        if self.parameters and self.parameters != ordered:
            raise UsageError(
                "the files do not have the same parameters.", file=file, hint="Reduce them one by one."
            )
        self.parameters = ordered

    def finish(self, sources: Sequence[Source], notices: Sequence[Notice], parts: Sequence[Part]) -> None:
        """Record the file the last blocks came from."""
        for source in sources:
            refuse_twin(self.sources, source.name, source.sha256)
        self.sources += sources
        self.notices += notices
        for part in parts:
            self.counts.update(part.counts)
            self.declared_units |= part.declared_units

    def add(self, frame: pd.DataFrame, file: str) -> None:
        """Check and add one block."""
        rows = frame["row"].to_numpy()
        ids = [codes_of(frame[c]) for c in IDS]
        # Ids are numbered once for each run of equal ones: files are mostly sorted.
        change = np.concatenate([[True], np.logical_or.reduce([c[1:] != c[:-1] for c, _ in ids])])
        starts = np.flatnonzero(change)
        lengths = np.diff(starts, append=len(rows))
        registries = (self.subjects, self.sessions, self.environments)
        subject, session, place = (
            registry.numbers(codes[starts], names)
            for registry, (codes, names) in zip(registries, ids, strict=True)
        )
        for registry, what in zip(registries, IDS, strict=True):
            if len(registry.names) > _ID:
                raise UsageError(f"more than {_ID} {what}s.", file=file, column=what)
        visits = self.visits.numbers(*distinct((subject << 2 * _BITS) | (session << _BITS) | place))
        cells = self.cells.numbers(*distinct((subject << _BITS) | place))
        visit, cell, environment = (np.repeat(run, lengths) for run in (visits, cells, place))
        self.rows = np.concatenate(
            [self.rows, np.zeros(len(self.cells.names) - len(self.rows), dtype=np.int64)]
        )
        self.rows += np.bincount(cell, minlength=len(self.rows))
        self._check_trials(visits, visit, frame["trial"].to_numpy(), rows, file)
        responses = [self._response(p, frame, environment, file) for p in self.parameters]
        complete = ~np.isnan(responses).any(axis=0)
        self.counts["observations"] += len(frame)
        self.counts["rows without every parameter"] += int((~complete).sum())
        if complete.all():
            self._accumulate(cell, responses)
        else:
            self._accumulate(cell[complete], [y[complete] for y in responses])

    def _check_trials(
        self,
        visits: npt.NDArray[np.int64],
        visit: npt.NDArray[np.int64],
        trial: npt.NDArray[np.int64],
        rows: npt.NDArray[np.int64],
        file: str,
    ) -> None:
        """Find a trial that stands twice: one mark for each place in the visits × trials grid."""
        shape = (len(self.visits.names), int(trial.max()) + 1)
        if int(trial.min()) < 0 or shape[0] * shape[1] > _TRIALS:
            at = int(np.argmin(trial) if trial.min() < 0 else np.argmax(trial))
            raise UsageError(
                "trial numbers are negative or too large to be checked in blocks.",
                file=file,
                row=int(rows[at]),
                column="trial",
                value=int(trial[at]),
                hint="Number the trials of each subject and environment 1, 2, 3 …",
            )
        self.seen = grown(self.seen, shape)
        # Marking the trials and counting the marks is cheaper than looking each of them up.
        touched = np.unique(visits)
        before = self.seen[touched]
        key = visit * self.seen.shape[1] + trial
        self.seen.reshape(-1)[key] = True
        if np.count_nonzero(self.seen[touched]) - np.count_nonzero(before) < len(key):
            earlier = before[np.searchsorted(touched, visit), trial] | pd.Series(key).duplicated().to_numpy()
            at = int(np.argmax(earlier))
            raise UsageError(
                f"trial {int(trial[at])} of this subject, session and environment stands twice.",
                file=file,
                row=int(rows[at]),
                column="trial",
                hint="Remove one of the rows, or number the trials.",
            )

    def _response(
        self, p: str, frame: pd.DataFrame, environment: npt.NDArray[np.int64], file: str
    ) -> _Floats:
        adjusted = frame[f"{p}_adj"].to_numpy(dtype=float)
        reference = self._reference(p, frame, environment, file)
        zeros = adjusted <= 0 if self.family == "lognormal" else np.zeros(0, dtype=bool)
        # A reference is the same in all rows of an environment, so its few values are looked at first.
        if (self.references[p] <= 0).any() or zeros.any():
            bad = reference <= 0
            at = int(np.argmax(bad | zeros if len(zeros) else bad))
            raise RefusalError(
                f"no response in the family {self.family!r}.",
                file=file,
                row=int(frame["row"].iloc[at]),
                column=f"{p}_adj",
                value=float(adjusted[at]),
                hint="Zero and negative adjustments need the normal family; references are positive.",
            )
        if self.family == "lognormal":
            return np.log(adjusted / reference)
        return (adjusted - reference) / reference

    def _reference(
        self, p: str, frame: pd.DataFrame, environment: npt.NDArray[np.int64], file: str
    ) -> _Floats:
        """Give each row's reference; the scene's and the file's must be one number per environment."""
        known = self.references[p]
        names = self.environments.names[len(known) :]
        declared = [self.options.environments.get(n, {}).get(f"{p}_ref", np.nan) for n in names]
        known = np.concatenate([known, np.array(declared, dtype=float)])
        given = frame[f"{p}_ref"].to_numpy(dtype=float)
        if np.isnan(known).any():
            first = np.full(len(known), np.nan)
            at = np.flatnonzero(~np.isnan(given))[::-1]
            first[environment[at]] = given[at]
            known = np.where(np.isnan(known), first, known)
        self.references[p] = known
        expected = known[environment]
        if np.array_equal(given, expected):
            return expected
        lacking = np.isnan(expected) & ~np.isnan(frame[f"{p}_adj"].to_numpy(dtype=float))
        differ = (given != expected) & ~np.isnan(given)
        if differ.any() or lacking.any():
            row = int(np.argmax(differ | lacking))
            name = self.environments.names[environment[row]]
            wrong = (
                f"the reference {expected[row]!s} in an earlier row or the scene"
                if differ[row]
                else "no reference so far"
            )
            raise UsageError(
                f"environment {name!r} has {wrong}.",
                file=file,
                row=int(frame["row"].iloc[row]),
                column=f"{p}_ref",
                value=float(given[row]) if differ[row] else None,
                hint=f"An environment has one reference: in its first rows, or as {p}_ref in [environments].",
            )
        return expected

    def _accumulate(self, cell: npt.NDArray[np.int64], responses: Sequence[_Floats]) -> None:
        """Merge a block into the cells' moments.

        Within the block sums are taken about each cell's first response, so that nothing is lost to an
        offset; blocks are merged by the pairwise update of Chan, Golub & LeVeque (1983).
        """
        count = len(self.cells.names)
        self.n, self.means, self.scatters = (
            np.concatenate([a, np.zeros((*a.shape[:-1], count - a.shape[-1]))], axis=-1)
            for a in (self.n, self.means, self.scatters)
        )
        if not len(cell):
            return
        starts = np.flatnonzero(np.concatenate([[True], cell[1:] != cell[:-1]]))
        heads, lengths = cell[starts], np.diff(starts, append=len(cell))

        def total_of(y: _Floats) -> _Floats:
            sums = np.bincount(heads, weights=np.add.reduceat(y, starts), minlength=count)
            return sums.astype(np.float64, copy=False)

        n = np.bincount(heads, weights=lengths, minlength=count)
        here = np.flatnonzero(n)
        shift = np.zeros((len(responses), count))
        for at, y in enumerate(responses):
            shift[at, heads[::-1]] = y[starts[::-1]]
        moved = [y - np.repeat(shift[at, heads], lengths) for at, y in enumerate(responses)]
        sums = [total_of(y)[here] / n[here] for y in moved]
        before, total = self.n[here], self.n[here] + n[here]
        gaps = [shift[at, here] + sums[at] - self.means[at, here] for at in range(len(responses))]
        for at, (i, j) in enumerate(((0, 0), (0, 1), (1, 1))):
            if j >= len(responses):
                continue
            squares = total_of(moved[i] * moved[j])[here]
            own = squares - n[here] * sums[i] * sums[j]
            self.scatters[at, here] += own + gaps[i] * gaps[j] * (before * n[here] / total)
        for at, gap in enumerate(gaps):
            self.means[at, here] += gap * (n[here] / total)
        self.n[here] = total

    def reduced(self) -> Reduced:
        """Lay the accumulators out as tables."""
        packed = np.array(self.cells.names, dtype=np.int64)
        cells = pd.DataFrame(
            {
                "subject": [self.subjects.names[i] for i in packed >> _BITS],
                "environment": [self.environments.names[i] for i in packed & _ID],
                "n": self.n.astype(np.int64),
            }
        )
        cells["sessions"] = self._sessions_of(packed)
        where = {p: at for at, p in enumerate(self.parameters)}
        # Zeros of a cell that holds no trial would read as data.
        sums = np.where(self.n > 0, np.concatenate([self.means, self.scatters]), np.nan)
        blank = np.full(len(cells), np.nan)
        for p in ("k", "b"):
            cells[f"mean_{p}"] = sums[where[p]] if p in where else blank
        for pair in ("kk", "kb", "bb"):
            known = pair[0] in where and pair[1] in where
            cells[f"scatter_{pair}"] = sums[2 + where[pair[0]] + where[pair[1]]] if known else blank
        references: dict[str, Any] = {"environment": self.environments.names}
        for p in ("k", "b"):
            references[f"{p}_ref"] = self.references[p] if p in where else np.nan
        self._check_units()
        self.notices += never_named(self.options, self.environments.names)
        if self.options.unfinished == "exclude":
            cells = self._finished(cells)
        ids: dict[str, Iterable[str]] = {
            "subject": cells["subject"].unique(),
            "session": self.sessions.names,
            "environment": cells["environment"].unique(),
        }
        for what, names in ids.items():
            self.notices += look_alikes(names, what)
        self.notices += repeats_over_sessions(cells.pop("sessions"))
        return Reduced(
            cells,
            pd.DataFrame(references),
            "lognormal" if self.family == "lognormal" else "normal",
            tuple(self.sources),
            tuple(dict.fromkeys(self.notices)),
            dict(self.counts),
        )

    def _sessions_of(self, cells: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
        """Count the sessions that each cell's trials are from."""
        visits = np.array(self.visits.names, dtype=np.int64)
        of_visit = (visits >> 2 * _BITS << _BITS) | (visits & _ID)
        known, counts = np.unique(of_visit, return_counts=True)
        return counts[np.searchsorted(known, cells)]

    def _check_units(self) -> None:
        """Compare adjustments with references as `check_plausible` does, trials by their cell's mean."""
        units = self.declared_units | units_of_scene(self.options.environments)
        for mean, p in zip(self.means, self.parameters, strict=False):
            ratio = np.exp(mean) if self.family == "lognormal" else 1.0 + mean
            known = np.flatnonzero((ratio > 0) & (self.n > 0))
            if not known.size:
                continue
            rising = known[np.argsort(ratio[known])]
            reached = np.cumsum(self.n[rising])
            typical = ratio[rising[np.searchsorted(reached, 0.5 * reached[-1])]]
            doubt = unit_doubt(p, float(typical), units)
            if doubt is None:
                continue
            if doubt.hint is not None:
                raise UsageError(doubt.text, file=self.sources[0].name, column=f"{p}_adj", hint=doubt.hint)
            self.notices.append(Notice(doubt.text, column=f"{p}_adj"))

    def _finished(self, cells: pd.DataFrame) -> pd.DataFrame:
        """Leave out subjects who lack an environment that others have."""
        kept, unfinished = drop_unfinished(cells)
        if unfinished:
            self.counts["excluded: unfinished subject"] = int(self.rows.sum() - self.rows[kept.index].sum())
        return kept.reset_index(drop=True)
