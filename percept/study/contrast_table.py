"""Rows of contrasts: what each one says, in numbers and in a sentence, and how they are chosen."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from percept.errors import UsageError, counted
from percept.inference.record import Kind, Method, percent
from percept.results import ContrastRow
from percept.scene import InferenceTable
from percept.sessions.quantities import Quantity
from percept.study.basics import Array
from percept.study.conditions import Comparison
from percept.study.data import Data

__all__ = ["ContrastTable", "chosen_contrasts"]


@dataclasses.dataclass(frozen=True, eq=False)
class ContrastTable:
    """How the contrasts of one quantity become rows."""

    data: Data
    parameter: str

    @property
    def quantity(self) -> Quantity:
        """The quantity."""
        return self.data.quantities[self.parameter]

    @property
    def inference(self) -> InferenceTable:
        """What the scene asks of all intervals."""
        return self.data.asked

    @property
    def scale(self) -> float | None:
        """Scale of differences in the quantity's unit; None for ratios and for references."""
        if not self.data.by_difference(self.parameter):
            return None
        return self.data.scene.model.scale.get(self.parameter)

    @property
    def references(self) -> int:
        """Number of references that the factors have."""
        factors = self.data.sessions.factors
        return len(factors.environments if factors else self.data.environments)

    def row(
        self,
        comparison: Comparison,
        ends: Sequence[float] | Array,
        n: int,
        *,
        method: Method,
        kind: Kind | None = None,
        p_value: float | None = None,
        together: Sequence[float] | None = None,
    ) -> ContrastRow:
        """Make a row of lower, upper and estimate on the response scale; without kind: spread."""
        asked = self.inference
        share = kind == "share"
        log = asked.family == "lognormal"
        lower, upper, estimate = self._native(ends) if kind else np.asarray(ends).tolist()
        lower_together, upper_together = self._native(together) if together else (None, None)
        return ContrastRow(
            factor=comparison.factor,
            first=comparison.first,
            second=comparison.second,
            environment=comparison.environment,
            references=comparison.references,
            parameter=self.parameter,
            of=comparison.of if kind else "spread",
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
            unit="" if log or not kind else self.unit,
            p_value=p_value,
            within=comparison.within,
            n=n,
            of_subjects=len(self.data.sessions.subjects),
            of_references=self.references,
            covers=self._covers(comparison, kind, method, n),
        )

    def _native(self, responses: Sequence[float] | Array) -> list[float]:
        """Differences on the response scale as ratios, or in the quantity's unit."""
        values = np.asarray(responses, dtype=float)
        if self.inference.family == "lognormal":
            with np.errstate(over="ignore"):
                values = np.exp(values)
        elif self.scale is not None:
            values = values * self.scale
        return [float(value) for value in values]

    @property
    def unit(self) -> str:
        """Unit of differences."""
        return "references" if self.scale is None else self.quantity.unit or "units"

    def _basis(self, comparison: Comparison, n: int) -> str:
        """Say which subjects and references a contrast rests on."""
        subjects = len(self.data.sessions.subjects)
        users = f"from {n} of {counted(subjects, *self.data.scene.user_noun)}"
        if comparison.within:
            basis = {"interaction": ", with all levels", "bias": ", with both levels"}
            users += basis.get(comparison.of, "")
        if comparison.environment is not None:
            return users
        references = comparison.references
        if len(references) == self.references:
            if self.references == 1:
                return users
            return f"{users}, over all {self.references} references"
        return f"{users}, over {len(references)} of {self.references} references: " + ", ".join(
            references
        )

    def _covers(self, comparison: Comparison, kind: str | None, method: str, n: int) -> str:
        """Say in a sentence what a contrast's limits hold."""
        first = comparison.first
        second = comparison.second
        log = self.inference.family == "lognormal"
        user, users = self.data.scene.user_noun
        how = f"{second} over {first}"
        if not log and kind:
            how = f"{second} less {first}, in {self.unit}"
        sure = percent(self.inference.confidence if kind == "share" else self.inference.level)
        if method == "classical":
            sure += " confidence"
        else:
            sure += " probability under the model and its priors"
        what = f"{'ratio' if log else 'difference'} of {self.quantity.label} ({how})"
        if comparison.interaction:
            what = f"interaction {comparison.factor} of {self.quantity.label} ({how})"
        if not kind:
            start = f"The ratio of SDs between {users} of {self.quantity.label} ({how})"
        elif kind == "share":
            start = f"For at least {percent(self.inference.share)} of all {users} the {what}"
        else:
            who = "next" if kind == "user" else "typical" if log else "average"
            start = f"The {who} {user}'s {what}"
        basis = self._basis(comparison, n)
        covers = f"{start} lies between the limits, with {sure} ({basis})."
        if method == "classical" and len(self.data.parameters) > 1:
            covers += " Each quantity is compared by itself, without correlations."
        return covers


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
    ratio = not row.unit

    def turn(value: float) -> float:
        return 1.0 / value if ratio else -value

    covers = row.covers
    for word in ("over", "less"):
        covers = covers.replace(
            f"{row.second} {word} {row.first}", f"{row.first} {word} {row.second}"
        )
    return dataclasses.replace(
        row,
        first=row.second,
        second=row.first,
        lower=turn(row.upper),
        estimate=turn(row.estimate),
        upper=turn(row.lower),
        lower_together=None if row.upper_together is None else turn(row.upper_together),
        upper_together=None if row.lower_together is None else turn(row.lower_together),
        covers=covers,
    )
