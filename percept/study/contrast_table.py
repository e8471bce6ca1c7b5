"""Rows of contrasts: what each one says, in numbers and in a sentence, and how they are chosen."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd

from percept.errors import UsageError, counted
from percept.inference.record import percent
from percept.scene import InferenceTable
from percept.sessions.quantities import Quantity
from percept.study.basics import Array
from percept.study.conditions import Comparison
from percept.study.intervals import Row

__all__ = ["ContrastTable", "chosen_contrasts"]


@dataclasses.dataclass(frozen=True)
class ContrastTable:
    """How the contrasts of one quantity become rows."""

    quantity: Quantity
    inference: InferenceTable
    alone: bool  # Whether it is the only quantity analysed
    scale: float | None  # Of differences in the quantity's unit; None for ratios and for references
    subjects: int  # In the study
    references: int  # That the factors have
    users: tuple[str, str]  # What the study calls one user and several

    def row(
        self,
        comparison: Comparison,
        ends: Sequence[float] | Array,
        n: int,
        *,
        method: str,
        kind: str | None = None,
        p_value: float | None = None,
        together: Sequence[float] | None = None,
    ) -> Row:
        """Make a row of lower, upper and estimate on the response scale; without kind: spread."""
        inference = self.inference
        share = kind == "share"
        log = inference.family == "lognormal"
        lower, upper, estimate = self._native(ends) if kind else np.asarray(ends).tolist()
        lower_together, upper_together = self._native(together) if together else (None, None)
        return {
            "factor": comparison.factor,
            "first": comparison.first,
            "second": comparison.second,
            "environment": comparison.environment,
            "references": list(comparison.references),
            "parameter": self.quantity.name,
            "of": comparison.of if kind else "spread",
            "kind": kind,
            "method": method,
            "family": inference.family,
            "level": inference.level,
            "share": inference.share if share else None,
            "confidence": inference.confidence if share else None,
            "lower": lower,
            "upper": upper,
            "estimate": estimate,
            "lower_together": lower_together,
            "upper_together": upper_together,
            "unit": "" if log or not kind else self.unit,
            "p_value": p_value,
            "within": comparison.within,
            "n": n,
            "of_subjects": self.subjects,
            "of_references": self.references,
            "covers": self._covers(comparison, kind, method, n),
        }

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
        users = f"from {n} of {counted(self.subjects, *self.users)}"
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
        user, users = self.users
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
        if method == "classical" and not self.alone:
            covers += " Each quantity is compared by itself, without correlations."
        return covers


def chosen_contrasts(contrasts: pd.DataFrame, asked: str) -> pd.DataFrame:
    """Choose the contrasts of a factor, or of two of its levels: "hand: left - right"."""
    factor, _, levels = (part.strip() for part in asked.partition(": "))
    factors = [] if contrasts.empty else list(contrasts["factor"].unique())
    if factor not in factors:
        hint = f"There are {', '.join(factors)}." if factors else "Name factors in [model] bias."
        raise UsageError("the model has no such term.", value=factor, hint=hint)
    rows = contrasts[contrasts["factor"] == factor]
    if not levels:
        return rows.reset_index(drop=True)
    second, _, first = (part.strip() for part in levels.partition(" - "))
    straight = rows[(rows["second"] == second) & (rows["first"] == first)]
    if len(straight):
        return straight.reset_index(drop=True)
    turned = rows[(rows["second"] == first) & (rows["first"] == second)]
    if turned.empty:
        pairs = rows.drop_duplicates(["second", "first"])
        there = " and ".join(pairs["second"] + " - " + pairs["first"])
        hint = f"The model compares {there}."
        raise UsageError(f"{factor} has no such contrast of two levels.", value=levels, hint=hint)
    return _turned(turned).reset_index(drop=True)


def _turned(rows: pd.DataFrame) -> pd.DataFrame:
    """Contrasts of the first level against the second."""
    ratio = rows["unit"] == ""
    changed = rows.assign(first=rows["second"], second=rows["first"])
    ends = (
        ("lower", "upper"),
        ("estimate", "estimate"),
        ("upper", "lower"),
        ("lower_together", "upper_together"),
        ("upper_together", "lower_together"),
    )
    for name, other in ends:
        # Where there are no limits together, the column holds None or NaN.
        values = rows[other].astype(float)
        changed[name] = np.where(ratio, 1.0 / values, -values)
    covers = []
    for row in rows.itertuples():
        said = str(row.covers)
        for word in ("over", "less"):
            said = said.replace(
                f"{row.second} {word} {row.first}", f"{row.first} {word} {row.second}"
            )
        covers.append(said)
    return changed.assign(covers=covers)
