"""Files larger than memory, read block by block and reduced to what models need."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import RefusalError, UsageError
from percept.sessions import checks, doubts
from percept.sessions.options import DataTables, ReadOptions
from percept.sessions.quantities import Quantities
from percept.sessions.reading import Reading
from percept.sessions.records import IDS, Notice, Place, Places, Source
from percept.sessions.table import FileTable

__all__ = ["Reduced", "reduce_sessions"]

#: Each trial of a subject, session and environment takes a bit, so that its number is bounded.
_TRIALS = 1 << 24
#: Rows of visits that blocks leave before they are merged.
_VISITS = 1 << 16
_Family = Literal["lognormal", "normal"]


@dataclass(frozen=True, eq=False)
class Reduced:
    """Sufficient statistics of a study's responses.

    Attributes
    ----------
    cells : DataFrame
        One row per subject and environment, in order of first appearance: `subject`, `environment`,
        `n` (trials with every parameter), `mean_k`, `mean_b` (mean response, unit-free), and the
        sums of squares and products about the means `scatter_kk`, `scatter_kb`, `scatter_bb`.
        Columns of a parameter that was not measured are NaN.
    references : DataFrame
        In the order the scene lists, then by reference: `environment`, `k_ref` (N/m), `b_ref`
        (N·s/m).
    family : {"lognormal", "normal"}
        A response is log(adjusted/reference), or (adjusted − reference)/reference.
    sources, notices, warnings, counts, options
        As of :class:`Sessions`; warnings of the first trial of every subject, session and
        environment.
    """

    cells: pd.DataFrame
    references: pd.DataFrame
    family: _Family
    sources: tuple[Source, ...] = ()
    notices: tuple[Notice, ...] = ()
    warnings: tuple[Notice, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    options: ReadOptions = field(default_factory=ReadOptions)

    @property
    def quantities(self) -> Quantities:
        """What may be adjusted, by name."""
        return self.options.quantities


def reduce_sessions(
    *paths: str | Path,
    family: _Family = "lognormal",
    scene: DataTables | None = None,
    columns: Mapping[str, Any] | None = None,
) -> Reduced:
    """Read files of any size in bounded memory, with the checks of :func:`read_sessions`.

    Parameters
    ----------
    *paths : str or Path
        As for :func:`read_sessions`. Memory holds a few megabytes of a file at a time, and a bit
        per trial.
    family : {"lognormal", "normal"}, optional
        Scale of the responses.
    scene, columns
        As for :func:`read_sessions`.

    Returns
    -------
    Reduced

    Raises
    ------
    UsageError
        As :func:`read_sessions`; reading ends with the block in which something is wrong. Units are
        held to the first trial of every subject, session and environment.
    RefusalError
        An adjustment of zero or below on the log scale, or such a reference on either.
    """
    if family not in ("lognormal", "normal"):
        raise UsageError('family is "lognormal" or "normal".', value=family)
    reading = Reading(ReadOptions.of(scene).with_columns(columns))
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
        self.options = reading.options
        self.family: _Family = family
        self.parameters: tuple[str, ...] = ()
        self.numbered = False  # Whether a column of the file numbers the trials
        self.products: dict[str, tuple[str, str]] = {}  # From a scatter's name to its parameters
        self.references: dict[str, dict[str, float]] = {}
        self.visits: list[pd.DataFrame] = []
        self.seen: dict[Hashable, int] = {}  # By visit, its trials as the bits of a whole number

    def measure(self, table: FileTable) -> None:
        """Hold every file to trials of the same parameters."""
        if table.form != "trials":
            hint = "Read it with read_sessions."
            raise UsageError("a published summary is not reduced.", file=table.name, hint=hint)
        parameters = tuple(p for p in self.options.quantities if p in table.parameters)
        if self.parameters and self.parameters != parameters:
            message = "the files do not have the same parameters."
            raise UsageError(message, file=table.name, hint="Reduce them one by one.")
        self.parameters = parameters
        self.numbered = table.numbered
        self.products = _products(parameters)

    def add(self, frame: pd.DataFrame, file: str) -> None:
        """Check and add one block."""
        problems = self.reading.problems
        lines = frame["row"].to_numpy()

        def place(row: int) -> Place:
            return Place(file=file, row=int(lines[row]))

        checks.settle_references(
            frame, self.options.environments, self.references, self.parameters, place, problems
        )
        if self.options.sessions.trial != "order":
            self._check_trials(frame, place)
        problems.raise_if_any()
        responses = {f"mean_{p}": self._response(p, frame, place) for p in self.parameters}
        means = pd.DataFrame(responses)
        complete = means.notna().all(axis=1)
        parts = frame.assign(
            file=len(self.reading.sources),
            **means.where(complete, 0.0),
            rows=1,
            n=complete.astype(int),
        )
        for product in self.products:
            parts[product] = 0.0
        self.visits.append(self._merged(parts, list(IDS)))
        if sum(len(visits) for visits in self.visits) > _VISITS:
            self.visits = [self._merged(pd.concat(self.visits), list(IDS))]

    def _check_trials(self, frame: pd.DataFrame, place: Places) -> None:
        """Find trials that stand twice, in this block or in an earlier one."""
        problems = self.reading.problems
        trials = frame["trial"].to_numpy()
        wrong = np.flatnonzero((trials < 0) | (trials >= _TRIALS))
        if len(wrong):
            row = int(wrong[0])
            message = "trial numbers are negative or too large to be checked in blocks."
            hint = "Number the trials of each subject and environment 1, 2, 3 …"
            value = int(trials[row])
            raise UsageError(message, column="trial", value=value, hint=hint, **place(row))
        checks.check_duplicates(frame, place, problems, numbered=self.numbered)
        again: list[int] = []
        for visit, rows in frame.groupby(list(IDS), sort=False).indices.items():
            own = _bits(trials[rows])
            before = self.seen.get(visit, 0)
            if before & own:
                again += [int(row) for row in rows if before >> int(trials[row]) & 1]
            self.seen[visit] = before | own
        if again and not problems.total:
            duplicates = checks.Duplicates(sorted(again), "an earlier row", self.numbered)
            duplicates.tell(frame, place, problems)

    def _response(self, p: str, frame: pd.DataFrame, place: Places) -> pd.Series[float]:
        """Unit-free responses of a parameter."""
        adjusted = frame[f"{p}_adj"]
        reference = frame[f"{p}_ref"]
        log = self.family == "lognormal"
        bad = (reference <= 0) | ((adjusted <= 0) & log)
        if bad.any():
            row = int(np.argmax(bad))
            message = f"no response in the family {self.family!r}."
            hint = "Zero and negative adjustments need the normal family; references are positive."
            value = float(adjusted.iloc[row])
            raise RefusalError(message, column=f"{p}_adj", value=value, hint=hint, **place(row))
        if log:
            return pd.Series(np.log(adjusted / reference))
        return (adjusted - reference) / reference

    def _merged(self, parts: pd.DataFrame, by: list[str]) -> pd.DataFrame:
        """Merge counts, means and scatters of the same cell; other columns keep its first row."""
        groups = parts.groupby(by, sort=False)
        cell = groups.ngroup().to_numpy()
        n = parts["n"]
        merged = parts.drop_duplicates(by).reset_index(drop=True)
        merged[["rows", "n"]] = groups[["rows", "n"]].sum().to_numpy()
        gaps = {}
        for p in self.parameters:
            mean = f"mean_{p}"
            merged[mean] = (n * parts[mean]).groupby(cell).sum() / merged["n"].clip(lower=1)
            gaps[p] = parts[mean] - merged[mean].to_numpy()[cell]
        # Scatters are about the means, and pandas compensates its sums: an offset costs neither any
        # digits.
        for name, (p, q) in self.products.items():
            about = parts[name] + n * gaps[p] * gaps[q]
            merged[name] = about.groupby(cell).sum()
        return merged

    def reduced(self) -> Reduced:
        """Check what needs the whole study, and lay the cells out."""
        reading = self.reading
        reading.refuse_nothing(self.visits)
        visits = self._merged(pd.concat(self.visits), list(IDS))
        reading.check(visits, self.parameters, visits["rows"])
        cells = self._merged(visits, ["subject", "environment"])
        reading.counts["rows without every parameter"] = int((cells["rows"] - cells["n"]).sum())
        references = self._references(visits)
        order = list(checks.in_order(references, self.options.environments))
        columns = {p: f"{p}_ref" for p in references}
        return Reduced(
            cells=self._measured(cells),
            references=references.rename(columns=columns)
            .loc[order]
            .rename_axis("environment")
            .reset_index(),
            family=self.family,
            sources=tuple(reading.sources),
            notices=tuple(dict.fromkeys(reading.notices)),
            warnings=tuple(self._warnings(visits, references)),
            counts=dict(reading.counts),
            options=self.options,
        )

    def _measured(self, cells: pd.DataFrame) -> pd.DataFrame:
        """Lay out measures of every quantity; a cell without a trial is blank, not zero."""
        names = list(self.options.quantities)
        measures = [*(f"mean_{p}" for p in names), *_products(names)]
        measured = cells.reindex(columns=measures).where(cells["n"] > 0)
        return pd.concat([cells[["subject", "environment", "n"]], measured], axis=1)

    def _references(self, visits: pd.DataFrame) -> pd.DataFrame:
        """Lay out the reference of every environment and quantity, by first appearance."""
        known = {
            p: pd.Series(self.references.get(f"{p}_ref"), dtype=float)
            for p in self.options.quantities
        }
        return pd.DataFrame(known).reindex(visits["environment"].unique())

    def _warnings(self, visits: pd.DataFrame, references: pd.DataFrame) -> Iterator[Notice]:
        """Warn of what the first trial of every visit shows."""
        quantities = [self.options.quantities[p] for p in self.parameters]
        pooled = self.options.pooled(visits.columns)
        place = self.reading.places(visits)
        yield from doubts.doubtful_scales(references, quantities)
        yield from doubts.screen(visits, quantities, place, pooled, self.family)


def _bits(trials: npt.NDArray[np.int64]) -> int:
    """Numbers of trials as the bits of a whole number."""
    bits = np.zeros(int(trials.max()) + 1, dtype=np.uint8)
    bits[trials] = 1
    return int.from_bytes(np.packbits(bits, bitorder="little").tobytes(), "little")


def _products(parameters: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Name the scatter of each pair of parameters, of each with itself too."""
    return {f"scatter_{p}{q}": (p, q) for p, q in combinations_with_replacement(parameters, 2)}
