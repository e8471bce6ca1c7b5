"""Files larger than memory: read block by block with the reader's checks, reduced to what models need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import RefusalError, UsageError
from percept.sessions import checks
from percept.sessions.options import ReadOptions
from percept.sessions.quantities import IMPEDANCE, Quantities
from percept.sessions.reading import Reading
from percept.sessions.records import IDS, Notice, Place, Source
from percept.sessions.table import FileTable

#: Each trial of a subject, session and environment takes a bit, so that its number is bounded.
_TRIALS = 1 << 24
#: Rows that warnings and units are looked for in, at most; of more every second, fourth … one.
_SCREENED = 1 << 18
_Family = Literal["lognormal", "normal"]


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
        In the order the scene lists, then by reference: `environment`, `k_ref` (N/m), `b_ref` (N·s/m).
    family : {"lognormal", "normal"}
        A response is log(adjusted/reference), or (adjusted − reference)/reference.
    sources : tuple of Source
    notices : tuple of Notice
    warnings : tuple of Notice
        As of :class:`Sessions`; of more than 262,144 rows an even sample is looked at.
    counts : mapping of str to int
        Rows by what became of them.
    quantities : mapping of str to Quantity
    """

    cells: pd.DataFrame
    references: pd.DataFrame
    family: _Family
    sources: tuple[Source, ...] = ()
    notices: tuple[Notice, ...] = ()
    warnings: tuple[Notice, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    quantities: Quantities = field(default_factory=lambda: IMPEDANCE)


def reduce_sessions(
    *paths: str | Path,
    family: _Family = "lognormal",
    columns: Mapping[str, Any] | None = None,
    options: ReadOptions | None = None,
) -> Reduced:
    """Read files of any size in bounded memory, with the checks of :func:`read_sessions`.

    Parameters
    ----------
    *paths : str or Path
        As for :func:`read_sessions`. Memory holds a few megabytes of a file at a time, and a bit per trial.
    family : {"lognormal", "normal"}, optional
        Scale of the responses.
    columns, options
        As for :func:`read_sessions`.

    Returns
    -------
    Reduced

    Raises
    ------
    UsageError
        As :func:`read_sessions`; reading ends with the block in which something is wrong.
    RefusalError
        An adjustment of zero or below on the log scale, or such a reference on either.
    """
    if family not in ("lognormal", "normal"):
        raise UsageError('family is "lognormal" or "normal".', value=family)
    reading = Reading((options or ReadOptions()).with_columns(columns))
    cells = _Cells(reading, family)
    with closing(reading.tables(paths)) as tables:
        for table in tables:
            with reading.problems.collecting():
                cells.measure(table)
                for frame in table.frames():
                    # Rows left out are counted; the log of single ones would grow with the file.
                    table.exclusions.clear()
                    if len(frame) and not reading.problems.total:
                        cells.add(frame, table.name)
            reading.problems.raise_if_any()
    return cells.reduced()


class _Cells:
    """Counts, means and scatters of every visit (a subject's session in an environment) so far."""

    def __init__(self, reading: Reading, family: _Family) -> None:
        self.reading = reading
        self.family: _Family = family
        self.parameters: Sequence[str] = ()
        self.references: dict[str, dict[str, float]] = {}
        self.numbered = False
        self.visits = pd.DataFrame()
        self.sample: list[pd.DataFrame] = []
        self.stride = 1
        # By visit, its trials as the bits of a whole number.
        self.seen: dict[tuple[str, ...], int] = {}

    def measure(self, table: FileTable) -> None:
        """Hold every file to trials of the same parameters."""
        if table.form != "trials":
            hint = "Read it with read_sessions."
            raise UsageError("a published summary is not reduced.", file=table.name, hint=hint)
        parameters = tuple(p for p in self.reading.options.quantities if p in table.parameters)
        if self.parameters and self.parameters != parameters:
            hint = "Reduce them one by one."
            raise UsageError("the files do not have the same parameters.", file=table.name, hint=hint)
        self.parameters, self.numbered = parameters, table.numbered

    def add(self, frame: pd.DataFrame, file: str) -> None:
        """Check and add one block."""
        problems, rows = self.reading.problems, frame["row"].to_numpy()
        place = lambda at: {"file": file, "row": int(rows[at])}  # noqa: E731
        declared = self.reading.options.environments
        checks.settle_references(frame, declared, self.references, self.parameters, place, problems)
        self._sample(frame)
        visits = frame.groupby(list(IDS), sort=False)
        if self.reading.options.trial != "order":
            self._check_trials(frame, visits.indices, place)
        problems.raise_if_any()
        responses = {p: self._response(p, frame, place) for p in self.parameters}
        complete = ~np.isnan(list(responses.values())).any(axis=0)
        parts = frame[list(IDS)].assign(rows=1.0, n=complete.astype(float))
        for p, response in responses.items():
            parts[f"mean_{p}"] = np.where(complete, response, 0.0)
        parts[[_scatter(*pair) for pair in _pairs(self.parameters)]] = 0.0
        block = self._sums(parts, list(IDS), visits.ngroup().to_numpy())
        self.visits = self._sums(pd.concat([self.visits, block]), list(IDS))

    def _sample(self, frame: pd.DataFrame) -> None:
        """Keep the rows of a block, and fewer of all where they have become too many."""
        self.sample.append(self._thinned(frame.assign(file=len(self.reading.sources))))
        if sum(map(len, self.sample)) > _SCREENED:
            self.stride *= 2
            self.sample = [self._thinned(part) for part in self.sample]

    def _thinned(self, part: pd.DataFrame) -> pd.DataFrame:
        """Take rows evenly, and the first of every visit, which else would seem not to have been tried."""
        even = part["row"].to_numpy() % self.stride == 0
        return part if self.stride == 1 else part[even | ~part.duplicated(list(IDS)).to_numpy()]

    def _check_trials(self, frame: pd.DataFrame, visits: Mapping[Any, Any], place: Place) -> None:
        """Find trials that stand twice, in this block or in an earlier one."""
        trials, problems = frame["trial"].to_numpy(), self.reading.problems
        wrong = (trials < 0) | (trials >= _TRIALS)
        if wrong.any():
            at = int(np.argmax(wrong))
            message = "trial numbers are negative or too large to be checked in blocks."
            hint = "Number the trials of each subject and environment 1, 2, 3 …"
            raise UsageError(message, column="trial", value=int(trials[at]), hint=hint, **place(at))
        if frame.duplicated(checks.TRIAL).any():
            checks.check_duplicates(frame, place, problems, numbered=self.numbered)
            return
        again: list[int] = []
        for visit, rows in visits.items():
            bits = np.zeros(int(trials[rows].max()) + 1, dtype=np.uint8)
            bits[trials[rows]] = 1
            own = int.from_bytes(np.packbits(bits, bitorder="little").tobytes(), "little")
            before = self.seen.get(visit, 0)
            again += [int(row) for row in rows if before >> int(trials[row]) & 1] if before & own else []
            self.seen[visit] = before | own
        where = lambda at: "an earlier row"  # noqa: E731
        checks.tell_duplicates(frame, sorted(again), where, place, problems, numbered=self.numbered)

    def _response(self, p: str, frame: pd.DataFrame, place: Place) -> npt.NDArray[np.float64]:
        adjusted, reference = (frame[f"{p}_{kind}"].to_numpy(dtype=float) for kind in ("adj", "ref"))
        log = self.family == "lognormal"
        bad = (reference <= 0) | (adjusted <= 0 if log else False)
        if bad.any():
            at = int(np.argmax(bad))
            message = f"no response in the family {self.family!r}."
            hint = "Zero and negative adjustments need the normal family; references are positive."
            raise RefusalError(message, column=f"{p}_adj", value=float(adjusted[at]), hint=hint, **place(at))
        return np.log(adjusted / reference) if log else (adjusted - reference) / reference

    def reduced(self) -> Reduced:
        """Check what needs the whole study, and lay the cells out."""
        reading = self.reading
        reading.refuse_nothing([self.visits])
        names = list(reading.options.quantities)
        environments = self.visits["environment"].unique().tolist()
        warnings = self._look()
        cells = self._sums(reading.settled(self.visits), ["subject", "environment"])
        reading.counts["rows without every parameter"] = int((cells["rows"] - cells["n"]).sum())
        measures = [*(f"mean_{p}" for p in names), *(_scatter(*pair) for pair in _pairs(names))]
        # Zeros of a cell that holds no trial would read as data.
        measured = cells.reindex(columns=measures).where(cells["n"] > 0)
        found = [cells[["subject", "environment"]], cells["n"].astype(np.int64), measured]
        columns = [f"{p}_ref" for p in names]
        known = [[self.references.get(c, {}).get(e, np.nan) for c in columns] for e in environments]
        references = pd.DataFrame(known, index=environments, columns=columns)
        order = checks.in_order(environments, references, reading.options.environments)
        references = references.loc[list(order)].rename_axis("environment").reset_index()
        return Reduced(
            cells=pd.concat(found, axis=1),
            references=references,
            family=self.family,
            sources=tuple(reading.sources),
            notices=tuple(dict.fromkeys(reading.notices)),
            warnings=warnings,
            counts=dict(reading.counts),
            quantities=reading.options.quantities,
        )

    def _look(self) -> tuple[Notice, ...]:
        """Check units and look for what is seldom meant, as the whole table's reader does."""
        reading, table = self.reading, pd.concat(self.sample, ignore_index=True)
        if self.stride > 1:
            reading.notices.append(Notice(f"units and warnings are of {len(table):,} rows, an even sample"))
        place = reading.place(table)
        known, units = [reading.options.quantities[p] for p in self.parameters], reading.declared_units
        reading.notices += checks.check_plausible(table, known, units, place, reading.problems)
        reading.problems.raise_if_any()
        return tuple(checks.screen(table, self.parameters, place, reading.pooled(table)))

    def _sums(self, parts: pd.DataFrame, by: list[str], code: Any = None) -> pd.DataFrame:
        """Merge counts, means and scatters of parts of the same cell, cells in order of first appearance."""
        code = parts.groupby(by, sort=False).ngroup().to_numpy() if code is None else code
        first = np.flatnonzero(~pd.Series(code).duplicated().to_numpy())

        def total(values: Any) -> npt.NDArray[np.float64]:
            return np.bincount(code, weights=values, minlength=len(first)).astype(np.float64)

        merged = parts[by].iloc[first].reset_index(drop=True)
        n = parts["n"].to_numpy()
        merged["rows"], merged["n"] = total(parts["rows"]), total(n)
        some, gaps = np.maximum(merged["n"].to_numpy(), 1.0), {}
        for p in self.parameters:
            values = parts[f"mean_{p}"].to_numpy()
            mean = total(n * values) / some
            # Once more about that mean: it loses nothing to an offset, and neither do the scatters.
            mean += total(n * (values - mean[code])) / some
            merged[f"mean_{p}"], gaps[p] = mean, values - mean[code]
        for pair in _pairs(self.parameters):
            inside = parts[_scatter(*pair)].to_numpy()
            merged[_scatter(*pair)] = total(inside + n * gaps[pair[0]] * gaps[pair[1]])
        return merged


def _pairs(parameters: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of parameters that have a product, each with itself too, in order."""
    return [(p, q) for at, p in enumerate(parameters) for q in parameters[at:]]


def _scatter(p: str, q: str) -> str:
    """Name the column of a pair's products about their means."""
    return f"scatter_{p}{q}"
