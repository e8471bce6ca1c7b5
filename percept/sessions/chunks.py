"""Files larger than memory: read block by block with the reader's checks, reduced to what models need."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, Literal

import numpy as np
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
_SCREENED = 1 << 16
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
        As of :class:`Sessions`; of more than 65,536 rows an even sample is looked at.
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
        self.reading, self.options = reading, reading.options
        self.family: _Family = family
        self.parameters: tuple[str, ...] = ()
        self.references: dict[str, dict[str, float]] = {}
        self.numbered = False
        self.visits: list[pd.DataFrame] = []
        self.sample: list[pd.DataFrame] = []
        self.stride = 1
        # By visit, its trials as the bits of a whole number.
        self.seen: dict[Hashable, int] = {}

    def measure(self, table: FileTable) -> None:
        """Hold every file to trials of the same parameters."""
        if table.form != "trials":
            hint = "Read it with read_sessions."
            raise UsageError("a published summary is not reduced.", file=table.name, hint=hint)
        parameters = tuple(p for p in self.options.quantities if p in table.parameters)
        if self.parameters and self.parameters != parameters:
            hint = "Reduce them one by one."
            raise UsageError("the files do not have the same parameters.", file=table.name, hint=hint)
        self.parameters, self.numbered = parameters, table.numbered

    def add(self, frame: pd.DataFrame, file: str) -> None:
        """Check and add one block."""
        problems, rows = self.reading.problems, frame["row"].to_numpy()
        place = lambda at: {"file": file, "row": int(rows[at])}  # noqa: E731
        declared = self.options.environments
        checks.settle_references(frame, declared, self.references, self.parameters, place, problems)
        frame = frame.assign(visit=frame.groupby(list(IDS), sort=False).ngroup())
        self._sample(frame.assign(first=~frame.duplicated("visit")))
        if self.options.trial != "order":
            self._check_trials(frame, place)
        problems.raise_if_any()
        responses = pd.DataFrame({f"mean_{p}": self._response(p, frame, place) for p in self.parameters})
        complete = responses.notna().all(axis=1)
        parts = responses.where(complete, 0.0).assign(visit=frame["visit"], rows=1, n=complete.astype(int))
        parts = parts.assign(**dict.fromkeys(_products(self.parameters), 0.0))
        ids = frame[[*IDS, "visit"]].drop_duplicates("visit")
        self.visits.append(ids.merge(self._merged(parts, ["visit"]), on="visit").drop(columns="visit"))
        if sum(map(len, self.visits)) > _SCREENED:
            self.visits = [self._merged(pd.concat(self.visits), list(IDS))]

    def _sample(self, frame: pd.DataFrame) -> None:
        """Keep the rows of a block, and fewer of all where they have become too many."""
        self.sample.append(self._thinned(frame.assign(file=len(self.reading.sources))))
        if sum(map(len, self.sample)) > _SCREENED:
            self.stride *= 2
            self.sample = [self._thinned(part) for part in self.sample]

    def _thinned(self, part: pd.DataFrame) -> pd.DataFrame:
        """Take rows evenly, and the first of every visit, which else would seem not to have been tried."""
        return part[(part["row"] % self.stride == 0) | part["first"]]

    def _check_trials(self, frame: pd.DataFrame, place: Place) -> None:
        """Find trials that stand twice, in this block or in an earlier one."""
        trials, problems = frame["trial"].to_numpy(), self.reading.problems
        wrong = (trials < 0) | (trials >= _TRIALS)
        if wrong.any():
            at = int(np.argmax(wrong))
            message = "trial numbers are negative or too large to be checked in blocks."
            hint = "Number the trials of each subject and environment 1, 2, 3 …"
            raise UsageError(message, column="trial", value=int(trials[at]), hint=hint, **place(at))
        if frame.duplicated(["visit", "trial"]).any():
            checks.check_duplicates(frame, place, problems, numbered=self.numbered)
            return
        again: list[int] = []
        names = frame.drop_duplicates("visit")[list(IDS)].itertuples(index=False, name=None)
        for visit, rows in zip(names, frame.groupby("visit").indices.values(), strict=True):
            bits = np.zeros(int(trials[rows].max()) + 1, dtype=np.uint8)
            bits[trials[rows]] = 1
            own = int.from_bytes(np.packbits(bits, bitorder="little").tobytes(), "little")
            before = self.seen.get(visit, 0)
            again += [int(row) for row in rows if before >> int(trials[row]) & 1] if before & own else []
            self.seen[visit] = before | own
        where = lambda at: "an earlier row"  # noqa: E731
        checks.tell_duplicates(frame, sorted(again), where, place, problems, numbered=self.numbered)

    def _response(self, p: str, frame: pd.DataFrame, place: Place) -> pd.Series[float]:
        adjusted, reference, log = frame[f"{p}_adj"], frame[f"{p}_ref"], self.family == "lognormal"
        bad = (reference <= 0) | ((adjusted <= 0) & log)
        if bad.any():
            at = int(np.argmax(bad))
            message = f"no response in the family {self.family!r}."
            hint = "Zero and negative adjustments need the normal family; references are positive."
            value = float(adjusted.iloc[at])
            raise RefusalError(message, column=f"{p}_adj", value=value, hint=hint, **place(at))
        return pd.Series(np.log(adjusted / reference)) if log else (adjusted - reference) / reference

    def _merged(self, parts: pd.DataFrame, by: list[str]) -> pd.DataFrame:
        """Merge counts, means and scatters of parts of the same cell, cells in order of first appearance."""
        n, names, products = parts["n"], [f"mean_{p}" for p in self.parameters], _products(self.parameters)
        weighted = parts[[*by, "rows", "n"]].assign(**{name: n * parts[name] for name in names})
        groups = weighted.groupby(by, sort=False)
        merged, cell = groups.sum().reset_index(), groups.ngroup().to_numpy()
        some = merged["n"].clip(lower=1)
        merged[names] = merged[names].div(some, axis=0)
        gaps = {p: parts[f"mean_{p}"] - merged[f"mean_{p}"].to_numpy()[cell] for p in self.parameters}
        # Scatters are about the means, and pandas compensates its sums: an offset costs neither any digits.
        scatters = {name: parts[name] + n * gaps[p] * gaps[q] for name, (p, q) in products.items()}
        merged[list(products)] = pd.DataFrame(scatters).groupby(cell).sum()
        return merged

    def reduced(self) -> Reduced:
        """Check what needs the whole study, and lay the cells out."""
        reading, names = self.reading, list(self.options.quantities)
        reading.refuse_nothing(self.visits)
        visits = self._merged(pd.concat(self.visits), list(IDS))
        environments = visits["environment"].unique()
        warnings = self._look()
        cells = self._merged(reading.settled(visits), ["subject", "environment"])
        reading.counts["rows without every parameter"] = int((cells["rows"] - cells["n"]).sum())
        measures = [*(f"mean_{p}" for p in names), *_products(names)]
        # Zeros of a cell that holds no trial would read as data.
        measured = cells.reindex(columns=measures).where(cells["n"] > 0)
        known = {f"{p}_ref": self.references.get(f"{p}_ref", {}) for p in names}
        references = pd.DataFrame({c: [own.get(e, np.nan) for e in environments] for c, own in known.items()})
        references = references.set_axis(environments).rename_axis("environment")
        order = checks.in_order(references, self.options.environments)
        return Reduced(
            cells=pd.concat([cells[["subject", "environment", "n"]], measured], axis=1),
            references=references.loc[list(order)].reset_index(),
            family=self.family,
            sources=tuple(reading.sources),
            notices=tuple(dict.fromkeys(reading.notices)),
            warnings=warnings,
            counts=dict(reading.counts),
            quantities=self.options.quantities,
        )

    def _look(self) -> tuple[Notice, ...]:
        """Check units and look for what is seldom meant, as the whole table's reader does."""
        reading, table = self.reading, pd.concat(self.sample, ignore_index=True)
        if self.stride > 1:
            reading.notices.append(Notice(f"units and warnings are of {len(table):,} rows, an even sample"))
        place = reading.place(table)
        known, units = [self.options.quantities[p] for p in self.parameters], reading.declared_units
        reading.notices += checks.check_plausible(table, known, units, place, reading.problems)
        reading.problems.raise_if_any()
        return tuple(checks.screen(table, self.parameters, place, reading.pooled(table), self.family))


def _products(parameters: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Name the scatter of each pair of parameters, of each with itself too."""
    return {f"scatter_{p}{q}": (p, q) for p, q in combinations_with_replacement(parameters, 2)}
