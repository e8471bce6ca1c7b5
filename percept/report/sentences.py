"""Sentences of the first screen: biases of the average user, and settings of the next one."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.numbers import bare, digits_of, rounded
from percept.report.select import (
    METHOD_NAMES,
    MOST_NAMED,
    MOST_OPEN,
    Words,
    distinct,
    listed,
    matching,
)
from percept.results import LadderEffect, OverviewRow
from percept.sessions.quantities import Quantity

__all__ = [
    "Bias", "bias_sentences", "biases_of", "cause_sentences", "disagreements", "ends",
    "mean_sentence", "named_or_counted", "size_said", "user_sentences",
]  # fmt: skip

#: A bias of so many references and more is written as a multiple.
_MULTIPLE = 9.0
#: An interval from below a hundredth to above a hundred references says nothing.
_NOTHING = 100.0
#: Per cent from which on two digits would round whole per cents away.
_LEAST_WHOLE = 99.5
#: Steps of the ladder that set the methods apart. Both are compared on one scale.
_CAUSES = {
    "prior": "the prior",
    "trials": "trial noise, which the model tells from differences between people",
    "pooling": "what the model learns from the other {}",
    "own_trials": "the trial SD that each person has",
    "correlation": "what the model learns from the other quantity",
}
#: Shift over the classical half-width, or log ratio of widths: twice the most error of a step.
_LEAST_MOVED = 0.1
#: Most digits of a range whose ends lie close together.
_MOST_DIGITS = 6


@dataclasses.dataclass(frozen=True)
class Bias:
    """A bias with its interval, or the next user's range, of one quantity of one environment."""

    row: OverviewRow
    lower: float  # -inf without a limit
    upper: float
    bias: float = math.nan

    @property
    def sign(self) -> int:
        """Return the sign of a bias, 0 where its interval holds zero."""
        if self.lower > 0:
            return 1
        return -1 if self.upper < 0 else 0

    @property
    def says_nothing(self) -> bool:
        """Whether the interval is so wide that its numbers are of no use."""
        lower = self.lower
        upper = self.upper
        # The next user's range has ratios to the reference, and no bias.
        if not math.isnan(self.bias):
            lower += 1.0
            upper += 1.0
        return self.row.relative and lower < 1.0 / _NOTHING and upper > _NOTHING


def bias_sentences(
    rows: Sequence[OverviewRow],
    others: Sequence[OverviewRow],
    quantities: Mapping[str, Quantity],
    words: Words,
    effects: Sequence[LadderEffect] = (),
) -> list[str]:
    """Say for every quantity how far users set it off, with interval, method and level.

    `others` are the rows of the classical method; where they see another sign, that is said too,
    with the cause that `effects` of the ladder name.
    """
    sentences = []
    for parameter in distinct(rows, "parameter"):
        biases = biases_of(matching(rows, parameter=parameter))
        if not biases:
            continue
        label = quantities[parameter].label
        if not quantities[parameter].is_matched:
            sentences.append(mean_sentence(biases, label, words))
            continue
        sentence = _bias_sentence(biases, capitalised(label), words)
        classical = biases_of(matching(others, parameter=parameter))
        apart = disagreements(biases, classical, words, matching(effects, parameter=parameter))
        sentences.append(" ".join([sentence, *apart]))
    return sentences


def biases_of(rows: Sequence[OverviewRow]) -> list[Bias]:
    """Return the biases that have an interval; an end without limit is infinite."""
    biases = []
    for row in rows:
        unlimited = row.bias_lower is None and row.bias_upper is None
        if row.bias is None or unlimited:
            continue
        lower = -math.inf if row.bias_lower is None else row.bias_lower
        upper = math.inf if row.bias_upper is None else row.bias_upper
        biases.append(Bias(row, lower, upper, row.bias))
    return biases


def _bias_sentence(biases: Sequence[Bias], name: str, words: Words) -> str:
    row = biases[0].row
    claim = f"{METHOD_NAMES[row.method]}, {percent(row.level)}"
    if all(bias.says_nothing for bias in biases):
        return f"{name}: these {words.subjects} are too few to say anything ({claim})."
    if len(biases) == 1:
        return f"{name} in {row.environment}: {_signed(biases[0])} ({claim}: {ends(biases[0])})."
    parts = []
    too = "too high", "too low"
    if not any(bias.row.reference for bias in biases):
        too = "above zero", "below zero"
    for sign, side in zip((1, -1), too, strict=True):
        same_sign = matching(biases, sign=sign)
        if same_sign:
            parts.append(f"{side} in {_sized(same_sign, len(biases), words)}")
    if parts:
        return f"{name} is {', and '.join(parts)} ({claim})."
    largest = max(matching(biases, says_nothing=False), key=_size)
    where = f"any of {len(biases)}" if len(biases) > 2 else "either of 2"
    return (
        f"{name} shows no clear bias in {where} {words.environments} ({claim}); the"
        f" largest is that of {_with_ends(largest)}."
    )


def mean_sentence(biases: Sequence[Bias], label: str, words: Words) -> str:
    """Give each environment its mean and interval; of many, the smallest and the largest."""
    row = biases[0].row
    claim = f"{METHOD_NAMES[row.method]}, {percent(row.level)}"
    if len(biases) <= MOST_NAMED:
        means = listed([_mean(bias) for bias in biases])
        return f"The mean {label} is {means} ({claim})."
    by_size = sorted(biases, key=lambda bias: bias.bias)
    return (
        f"The mean {label} of {len(biases)} {words.environments} is from {_mean(by_size[0])} to"
        f" {_mean(by_size[-1])} ({claim})."
    )


def _mean(bias: Bias) -> str:
    """Write a mean in its unit, its environment and its interval."""
    row = bias.row
    digits = digits_of(row.estimate, row.user_lower, row.user_upper)
    mean = bare(rounded(bias.bias, digits))
    unit = f" {row.unit}" if row.unit else ""
    lower = bare(rounded(bias.lower, digits))
    upper = bare(rounded(bias.upper, digits))
    return f"{mean}{unit} in {row.environment} ({lower} to {upper})"


def _size(bias: Bias) -> float:
    return abs(bias.bias)


def cause_sentences(
    effects: Sequence[LadderEffect], environments: Sequence[str], kind: str, words: Words
) -> list[str]:
    """Name the step of the ladder that moves the intervals of each environment most."""
    by_cause: dict[str, list[str]] = {}
    for environment in environments:
        of_environment = matching(effects, environment=environment, kind=kind)
        steps = [
            row for row in of_environment if row.cause in _CAUSES and _moved(row) > _LEAST_MOVED
        ]
        if steps:
            largest = max(steps, key=_moved)
            by_cause.setdefault(_CAUSES[largest.cause], []).append(environment)
    return [
        f"The main cause in {listed(names)} is {cause.format(words.environments)}."
        for cause, names in by_cause.items()
    ]


def _moved(step: LadderEffect) -> float:
    return max(abs(step.log_width), abs(step.centre))


def disagreements(
    biases: Sequence[Bias],
    others: Sequence[Bias],
    words: Words,
    effects: Sequence[LadderEffect] = (),
) -> list[str]:
    """Say where the classical interval sees another sign, or lies apart, and why."""
    classical = {other.row.environment: other for other in others}
    groups: dict[str, list[Bias]] = {}
    for bias in biases:
        other = classical.get(bias.row.environment)
        if other is None or bias.row.method == "classical" or other.says_nothing:
            continue
        apart = other.lower > bias.upper or other.upper < bias.lower
        if apart:
            holds = "lies apart"
        elif other.sign == bias.sign:
            continue
        else:
            holds = "holds zero" if other.sign == 0 else "excludes zero"
        groups.setdefault(holds, []).append(other)
    sentences = []
    environments = []
    for holds, classical_biases in groups.items():
        environments += [other.row.environment for other in classical_biases]
        if len(biases) == 1:
            sentences.append(f"The classical interval, {ends(classical_biases[0])}, {holds}.")
            continue
        named = [
            f"{other.row.environment} ({ends(other)})" for other in classical_biases[:MOST_NAMED]
        ]
        unnamed = len(classical_biases) - MOST_NAMED
        more = f" and {unnamed} more" if unnamed > 0 else ""
        sentences.append(f"The classical interval {holds} in {listed(named)}{more}.")
    return sentences + cause_sentences(effects, environments, "mean", words)


def _sized(biases: Sequence[Bias], every: int, words: Words) -> str:
    """Give each environment its bias and interval; of many, the smallest and the largest."""
    if len(biases) <= MOST_NAMED:
        return listed([_with_ends(bias) for bias in biases])
    count = f"all {every}" if len(biases) == every else f"{len(biases)} of {every}"
    by_size = sorted(biases, key=_size)
    extremes = f"{_with_ends(by_size[0])} to {_with_ends(by_size[-1])}"
    if len(biases) == every:
        return f"{count} {words.environments}, from {extremes}"
    names = [bias.row.environment for bias in biases[:MOST_OPEN]]
    more = ", …" if len(biases) > MOST_OPEN else ""
    return f"{count} {words.environments}: {', '.join(names)}{more}, from {extremes}"


def _with_ends(bias: Bias) -> str:
    return f"{bias.row.environment} ({_signed(bias)}, {ends(bias)})"


def _signed(bias: Bias) -> str:
    """Write the bias with its sign and unit."""
    return f"{_number(bias.bias, bias.row)}{_unit_of(bias.bias, bias.row)}"


def size_said(bias: Bias) -> str:
    """Write how large a bias is, with its unit; the sign is said beside it."""
    return _signed(bias).lstrip("+−")


def ends(bias: Bias) -> str:
    """Write the interval of the bias."""
    lower_unit = _unit_of(bias.lower, bias.row)
    upper_unit = _unit_of(bias.upper, bias.row)
    if lower_unit == upper_unit:
        lower_unit = ""
    lower = _number(bias.lower, bias.row)
    return f"{lower}{lower_unit} to {_number(bias.upper, bias.row)}{upper_unit}"


def _number(value: float, row: OverviewRow) -> str:
    """Write a bias with its sign: in per cent of the reference, or as a multiple from ten on."""
    if row.relative and _MULTIPLE <= value < math.inf:
        return bare(rounded(1.0 + value, 3))
    size = abs(100.0 * value if row.relative else value)
    # Differences have the digits of the estimate beside them in the table.
    digits = 2 if row.relative else digits_of(row.estimate, row.user_lower, row.user_upper)
    text = bare(rounded(size, digits))
    if row.relative and _LEAST_WHOLE <= size < math.inf:
        text = f"{size:.0f}"
    sign = "−" if value < 0 else "+"
    return text if text == "0" else f"{sign}{text}"


def _unit_of(value: float, row: OverviewRow) -> str:
    if not row.relative:
        return f" {row.unit}" if row.unit else ""
    return " times" if _MULTIPLE <= value < math.inf else " %"


def user_sentences(
    rows: Sequence[OverviewRow], quantities: Mapping[str, Quantity], words: Words
) -> list[str]:
    """Say where the next user's settings lie: in multiples of the reference, or how far from it."""
    sentences = []
    for parameter in distinct(rows, "parameter"):
        ranges = _user_ranges(matching(rows, parameter=parameter))
        if not ranges:
            continue
        row = ranges[0].row
        what = f"the next {words.user}’s {quantities[parameter].label}"
        determined = matching(ranges, says_nothing=False)
        undetermined = matching(ranges, says_nothing=True)
        sentence = []
        if determined:
            sure = "confidence" if row.method == "classical" else "probability"
            # From a reference of zero a difference is the value.
            matched = any(user.row.reference for user in ranges)
            ends = " and ".join(_extremes(determined, matched=matched, alone=len(ranges) == 1))
            sentence.append(f"With {percent(row.level)} {sure}, {what} will be {ends}.")
        if undetermined:
            names = [user.row.environment for user in undetermined]
            where = named_or_counted(names, len(ranges), words)
            sentence.append(f"These data do not determine {what} in {where}.")
        sentences.append(" ".join(sentence))
    return sentences


def _extremes(ranges: Sequence[Bias], *, matched: bool, alone: bool) -> list[str]:
    """Write the narrowest and the widest range; the environment of the only one goes unsaid."""
    by_width = sorted(ranges, key=lambda user: user.upper - user.lower)
    narrowest = by_width[0]
    written = _written(narrowest) if matched else _plain(narrowest)
    if alone:
        return [written]
    if len(ranges) == 1:
        return [f"{written} in {narrowest.row.environment}"]
    widest = by_width[-1]
    widest_written = _written(widest) if matched else _plain(widest)
    return [
        f"{written} ({narrowest.row.environment}, the narrowest)",
        f"{widest_written} ({widest.row.environment}, the widest)",
    ]


def named_or_counted(names: Sequence[str], every: int, words: Words) -> str:
    """Name some environments, or count them where they are many."""
    if len(names) > MOST_OPEN:
        return f"{len(names)} of {every} {words.environments}"
    return listed(names)


def _user_ranges(rows: Sequence[OverviewRow]) -> list[Bias]:
    """Return the next user's ranges, over the reference or less the reference."""
    ranges = []
    for row in rows:
        lower = row.user_lower_ratio if row.relative else row.user_bias_lower
        upper = row.user_upper_ratio if row.relative else row.user_bias_upper
        if lower is not None and upper is not None:
            ranges.append(Bias(row, lower, upper))
    return ranges


def _digits_between(lower: float, upper: float) -> int:
    """Return the digits that tell two ends apart: two, and more where they lie close together."""
    width = upper - lower
    size = max(abs(lower), abs(upper))
    if not (0.0 < width < math.inf and 0.0 < size < math.inf):
        return 2
    decades = math.log10(size / width)
    return 2 if decades < 1.0 else min(2 + math.ceil(decades), _MOST_DIGITS)


def _plain(user: Bias) -> str:
    """Write the next user's range where nothing was matched."""
    lower = bare(rounded(user.lower, digits_of(user.lower, user.lower, user.upper)))
    upper = bare(rounded(user.upper, digits_of(user.upper, user.lower, user.upper)))
    unit = f" {user.row.unit}" if user.row.unit else ""
    return f"{lower} to {upper}{unit}"


def _written(user: Bias) -> str:
    """Write the next user's range against the reference."""
    if user.row.relative:
        digits = _digits_between(user.lower, user.upper)
        ends = [bare(rounded(end, digits)) for end in (user.lower, user.upper)]
        return f"{' to '.join(ends)} times the reference"
    lower = bare(rounded(abs(user.lower), digits_of(user.lower, user.lower, user.upper)))
    upper = bare(rounded(abs(user.upper), digits_of(user.upper, user.lower, user.upper)))
    unit = f" {user.row.unit}" if user.row.unit else ""
    if user.lower >= 0:
        return f"{lower} to {upper}{unit} above the reference"
    if user.upper < 0:
        return f"{upper} to {lower}{unit} below the reference"
    return f"between {lower}{unit} below and {upper}{unit} above the reference"
