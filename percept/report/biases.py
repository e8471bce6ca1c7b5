"""How far users are off the references, and where the next user lies: numbers and sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.basics import (
    KINDS,
    METHOD_NAMES,
    MOST_NAMED,
    Estimated,
    best,
    distinct,
    families_from,
    family_of,
    grouped,
    listed,
    matching,
    present,
    unwidened,
    without_ratios,
)
from percept.results import MOST_SHOWN, IntervalRow, Results
from percept.sessions.quantities import Quantity

#: An interval from below a hundredth to above a hundred references says nothing.
_NOTHING = 100.0


@dataclass(frozen=True, kw_only=True)
class Bias(Estimated):
    """An interval against its reference: as fractions of it, or as differences in the unit."""

    row: IntervalRow
    environment: str
    parameter: str

    @property
    def relative(self) -> bool:
        """Whether it is a fraction of the reference."""
        return self.style == "bias"

    @property
    def sign(self) -> int:
        """The sign of the bias, 0 where its interval holds zero."""
        return int(self.lower > 0) - int(self.upper < 0)

    @property
    def says_nothing(self) -> bool:
        """Whether the interval is so wide that its numbers are of no use."""
        is_wide = self.lower + 1.0 < 1.0 / _NOTHING and self.upper + 1.0 > _NOTHING
        return self.relative and is_wide

    @property
    def named(self) -> str:
        """The environment, with estimate and limits."""
        return f"{self.environment} ({self.text(self.estimate)}, {self.limits})"


def biases_of(results: Results, **wanted: str) -> list[Bias]:
    """Return a bias for each environment and quantity, of rows whose fields have these values.

    It is of the average user if no other kind is wanted, and by the better method.
    """
    rows = matching(unwidened(results.intervals), **wanted)
    kind = next(iter(present(KINDS, rows, "kind")), "")
    families = families_from(family_of(results))
    return biases_among(matching(rows, kind=kind), results.data.quantities, families)


def biases_among(
    rows: Sequence[IntervalRow],
    quantities: Mapping[str, Quantity],
    families: Sequence[str],
) -> list[Bias]:
    """Return a bias for each environment and quantity that has one, by the better method."""
    biases = []
    absolute = without_ratios(rows)
    for of_cell in grouped(rows, "environment", "parameter").values():
        row = best(of_cell, families)
        reference = row.reference
        if reference is None:
            continue
        numbers = np.array([row.estimate, row.lower, row.upper])
        if row.parameter in absolute:
            off = numbers - reference
            style = "difference" if quantities[row.parameter].is_matched else "plain"
        else:
            off = numbers / reference - 1.0
            style = "bias"
        estimate, lower, upper = off.tolist()
        bias = Bias(
            estimate,
            lower,
            upper,
            unit="" if style == "bias" else row.unit,
            style=style,
            row=row,
            environment=row.environment,
            parameter=row.parameter,
        )
        biases.append(bias)
    return biases


def foremost(results: Results) -> list[str]:
    """Return the environments in figures and open tables: of many, the first."""
    return distinct(biases_of(results), "environment")[:MOST_SHOWN]


def drawn_said(results: Results) -> str:
    """Say that figures leave environments out; nothing where they have them all."""
    shown = len(foremost(results))
    every = len(distinct(results.intervals, "environment"))
    if shown == every:
        return ""
    words = results.data.words
    return (
        f"Figures, curves, couplings and results without each {words.subject} are of the first"
        f" {shown} of {every} {words.environments}."
    )


def bias_sentences(results: Results) -> list[str]:
    """Say for every quantity how far users set it off, and where the methods disagree."""
    every = biases_of(results)
    sentences = []
    for parameter, quantity in results.data.quantities.items():
        biases = matching(every, parameter=parameter)
        if not biases:
            continue
        row = biases[0].row
        said = capitalised(_off(biases, quantity, results))
        claim = f"{said} ({METHOD_NAMES[row.method]}, {percent(row.level)})."
        others = biases_of(results, method="classical", family=row.family)
        classical = matching(others, parameter=parameter)
        sentences.append(" ".join([claim, *_disagreements(biases, classical)]))
    return sentences


def _off(biases: Sequence[Bias], quantity: Quantity, results: Results) -> str:
    """Say on which side of the references users set a quantity, and in which environments."""
    words = results.data.words
    if not quantity.is_matched:
        means = _placed(biases, len(biases), words.environments)
        return f"mean {quantity.label} by {words.environment}: {means}"
    known = matching(biases, says_nothing=False)
    if not known:
        return f"{quantity.label}: these {words.subjects} are too few to say anything"
    zero = "the reference" if any(bias.row.reference for bias in biases) else "zero"
    parts = []
    for sign, side in ((1, "above"), (-1, "below")):
        same = matching(biases, sign=sign)
        if same:
            where = _placed(same, len(biases), words.environments)
            parts.append(f"{side} {zero} in {where}")
    if not parts:
        largest = max(known, key=lambda bias: abs(bias.estimate))
        which = f"in {largest.named}"
        if len(biases) > 1:
            every = f"in any of {len(biases)} {words.environments}"
            which = f"{every}; the largest is that of {largest.named}"
        parts = [f"with no clear bias {which}"]
    return f"{words.users} {words.verb} {quantity.label} {' and '.join(parts)}"


def _placed(biases: Sequence[Bias], every: int, environments: str) -> str:
    """Give each environment with its bias; of many, the smallest and the largest."""
    if len(biases) <= MOST_NAMED:
        return listed([bias.named for bias in biases])
    count = f"all {every}" if len(biases) == every else f"{len(biases)} of {every}"
    by_size = sorted(biases, key=lambda bias: abs(bias.estimate))
    return f"{count} {environments}, from {by_size[0].named} to {by_size[-1].named}"


def _disagreements(biases: Sequence[Bias], classical: Sequence[Bias]) -> list[str]:
    """Say where the classical interval has another sign, or lies apart."""
    by_name = {bias.environment: bias for bias in classical}
    groups: dict[str, list[Bias]] = {}
    for bias in biases:
        other = by_name.get(bias.environment)
        if other is None or bias.row.method == "classical" or other.says_nothing:
            continue
        if other.lower > bias.upper or other.upper < bias.lower:
            groups.setdefault("lies apart", []).append(other)
        elif other.sign != bias.sign and bias.style != "plain":
            holds = "excludes zero" if other.sign else "holds zero"
            groups.setdefault(holds, []).append(other)
    sentences = []
    for holds, others in groups.items():
        named = [f"{other.environment} ({other.limits})" for other in others]
        sentences.append(f"The classical interval {holds} in {listed(named, MOST_NAMED)}.")
    return sentences


def user_sentences(results: Results) -> list[str]:
    """Say where the next user's settings lie: the narrowest range and the widest."""
    sentences = []
    every = biases_of(results, kind="user")
    for parameter, quantity in results.data.quantities.items():
        biases = matching(every, parameter=parameter)
        what = f"the next {results.data.words.user}’s {quantity.label}"
        known = matching(biases, says_nothing=False)
        unknown = distinct(matching(biases, says_nothing=True), "environment")
        said = []
        if known:
            known.sort(key=lambda bias: bias.upper - bias.lower)
            ends = _range(known[0])
            if len(known) > 1:
                ends += f", the narrowest range, and {_range(known[-1])}, the widest"
            row = known[0].row
            sure = "confidence" if row.method == "classical" else "probability"
            said.append(f"With {percent(row.level)} {sure}, {what} will be {ends}.")
        if unknown:
            where = listed(unknown, MOST_SHOWN)
            said.append(f"These data do not determine {what} in {where}.")
        if said:
            sentences.append(" ".join(said))
    return sentences


def _range(bias: Bias) -> str:
    """Write where the next user's settings lie against the reference, and in which environment."""
    text = bias.limits
    if bias.relative:
        lower, upper = 1.0 + bias.lower, 1.0 + bias.upper
        text = Estimated(1.0 + bias.estimate, lower, upper, unit="times the reference").limits
    elif bias.row.reference:
        # From a reference of zero a difference is the value.
        text += " off the reference"
    return f"{text} in {bias.environment}"
