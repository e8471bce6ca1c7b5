"""Rows of contrasts: what each one says in numbers, and how they are chosen."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from percept.errors import UsageError
from percept.inference.record import FloatOrArray, Kind, Method
from percept.results import ContrastRow
from percept.study.comparisons import Comparison
from percept.study.data import Data


@dataclasses.dataclass(frozen=True, eq=False)
class ContrastTable:
    """How the contrasts of one quantity become rows."""

    data: Data
    parameter: str
    is_of_trials: bool = False  # Whether values are logarithms of SDs between trials

    @property
    def of_trials(self) -> ContrastTable:
        """The table of the quantity's precision."""
        return dataclasses.replace(self, is_of_trials=True)

    @property
    def label(self) -> str:
        """What is compared, in words."""
        label = self.data.quantities[self.parameter].label
        return f"precision of {label}" if self.is_of_trials else label

    @property
    def lacking(self) -> str:
        """What a cell without values lacks."""
        return "repeated trials" if self.is_of_trials else "data"

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """What intervals cover."""
        return ("mean",) if self.is_of_trials else self.data.asked.kinds

    def row(
        self,
        comparison: Comparison,
        ends: Sequence[FloatOrArray],
        n: int,
        method: Method,
        kind: Kind | None = None,
        *,
        together: Sequence[float] | None = None,
        **further: float | None,
    ) -> ContrastRow:
        """Make a row of lower, upper and estimate: of a kind on the response scale, else ratios.

        `further` are p-value, probability and d_z by their names in the row.
        """
        asked = self.data.asked
        factors = self.data.sessions.factors
        share = kind == "share"
        if self.is_of_trials and kind:
            ends = [float(np.exp(end)) for end in ends]
            kind = None
        of_ratio = "precision" if self.is_of_trials else "spread"
        lower, upper, estimate = self._native(ends) if kind else np.asarray(ends).tolist()
        lower_together, upper_together = self._native(together) if together else (None, None)
        return ContrastRow(
            factor=comparison.factor,
            first=comparison.first,
            second=comparison.second,
            environment=comparison.environment,
            references=comparison.references,
            parameter=self.parameter,
            of=comparison.of if kind else of_ratio,
            kind=kind,
            method=method,
            family=asked.family,
            level=asked.level,
            share=asked.share if share else None,
            confidence=asked.confidence if share else None,
            lower=lower,
            upper=upper,
            estimate=estimate,
            lower_together=lower_together,
            upper_together=upper_together,
            unit=self._unit if kind else "",
            within=comparison.within,
            n=n,
            of_subjects=len(self.data.sessions.subjects),
            of_references=len(factors.environments if factors else self.data.environments),
            **further,
        )

    @property
    def _scale(self) -> float | None:
        """Scale of differences in the quantity's unit; None for ratios and for references."""
        if not self.data.by_difference(self.parameter):
            return None
        return self.data.scene.model.scale.get(self.parameter, 1.0)

    @property
    def _unit(self) -> str:
        """Unit of differences; empty for ratios."""
        if self.data.asked.family == "lognormal":
            return ""
        unit = self.data.quantities[self.parameter].unit
        return "references" if self._scale is None else unit or "units"

    def _native(self, responses: Sequence[FloatOrArray]) -> list[float]:
        """Differences on the response scale as ratios, or in the quantity's unit."""
        values = np.asarray(responses, dtype=float)
        if self.data.asked.family == "lognormal":
            with np.errstate(over="ignore"):
                values = np.exp(values)
        elif self._scale is not None:
            values = values * self._scale
        return [float(value) for value in values]


def chosen_contrasts(contrasts: Sequence[ContrastRow], asked: str) -> list[ContrastRow]:
    """Choose the contrasts of a factor, or of two of its levels: "hand: left - right"."""
    factor, _, levels = (part.strip() for part in asked.partition(": "))
    rows = [row for row in contrasts if row.factor == factor]
    if not rows:
        factors = ", ".join(dict.fromkeys(row.factor for row in contrasts))
        hint = f"There are {factors}." if factors else "Name factors in [model] bias."
        raise UsageError("the model has no such term.", value=factor, hint=hint)
    if not levels:
        return rows
    second, _, first = (part.strip() for part in levels.partition(" - "))
    straight = [row for row in rows if (row.second, row.first) == (second, first)]
    turned = [_turned(row) for row in rows if (row.first, row.second) == (second, first)]
    if not straight and not turned:
        there = " and ".join(dict.fromkeys(f"{row.second} - {row.first}" for row in rows))
        hint = f"The model compares {there}."
        raise UsageError(f"{factor} has no such contrast of two levels.", value=levels, hint=hint)
    return straight or turned


def _turned(row: ContrastRow) -> ContrastRow:
    """Contrast the first level against the second."""

    def turned(value: float | None) -> Any:
        if value is None:
            return None
        return -value if row.unit else 1.0 / value

    above = row.probability_above
    return dataclasses.replace(
        row,
        first=row.second,
        second=row.first,
        estimate=turned(row.estimate),
        lower=turned(row.upper),
        upper=turned(row.lower),
        lower_together=turned(row.upper_together),
        upper_together=turned(row.lower_together),
        probability_above=None if above is None else 1.0 - above,
        d_z=None if row.d_z is None else -row.d_z,
    )
