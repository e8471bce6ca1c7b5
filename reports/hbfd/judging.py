"""A claim of the paper: the sentence as printed, its verdict, and the numbers the verdict rests on.

`claims.toml` holds the sentences and what is said of each. A function of the claim's name gives the
cases that decide the verdict, and the values that stand in the text.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Literal, TypeAlias

from percept.haptics import Device
from percept.report.basics import rounded
from reports.hbfd import claims_coupling, claims_figures, claims_table
from reports.hbfd.devices import DAMPINGS, MASSES
from reports.hbfd.published import Evidence, Published, Value, evidence

Verdict = Literal["holds", "holds only if", "does not hold", "cannot be judged"]
_Judge: TypeAlias = Callable[[Published], Evidence]

_MODULES = (claims_coupling, claims_figures, claims_table)


@dataclass(frozen=True)
class Quantity:
    """A number a verdict rests on."""

    name: str
    value: float  # With all its digits
    unit: str = ""  # "1" where the value is a fraction, which is read as a percentage

    @property
    def text(self) -> str:
        """The value as it is read, with its unit."""
        if self.unit == "1":
            return f"{rounded(100 * self.value, 4)} %"
        whole = float(self.value).is_integer()
        text = f"{self.value:.0f}" if whole else rounded(self.value)
        return f"{text} {self.unit}".rstrip()


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper and its verdict."""

    verdict: Verdict  # Follows from the cases the sentence speaks of
    condition: str  # What "only if" asks for, or what a judgement would need; empty otherwise
    finding: str
    margin: Quantity | None  # By how much the verdict is decided; None where it is not
    numbers: tuple[Quantity, ...]  # What else it rests on
    name: str  # Short, unique
    place: str  # Where in the paper
    quote: str  # The sentence, or the part of it that is judged, as printed


@dataclass(frozen=True)
class Sentence:
    """An entry of `claims.toml`: a sentence as printed, and the texts whose braces values fill."""

    name: str
    place: str
    quote: str
    finding: str
    condition: str = ""
    numbers: Sequence[tuple[str, str, str]] = ()  # Name, the value's key or path, and unit


class _Listed:
    """Several values in a sentence: names joined by "and", numbers by commas, with their names."""

    def __init__(self, values: Mapping[str, Value] | Sequence[Value]) -> None:
        self._values = values

    def __format__(self, spec: str) -> str:
        if isinstance(self._values, Mapping):
            return ", ".join(f"{value:{spec}} ({name})" for name, value in self._values.items())
        texts = [format(value, spec) for value in self._values] or ["none"]
        if spec or len(texts) == 1:
            return ", ".join(texts)
        return f"{', '.join(texts[:-1])} and {texts[-1]}"

    def __getitem__(self, index: int) -> Value:
        assert isinstance(self._values, Sequence)
        return self._values[index]


def verdict_of(cases: Iterable[bool] | None) -> Verdict:
    """Judge a sentence: it holds in all cases, in none, or else on a condition."""
    if cases is None:
        return "cannot be judged"
    true = [bool(case) for case in cases]
    if all(true):
        return "holds"
    return "holds only if" if any(true) else "does not hold"


def sentences() -> list[Sentence]:
    """Read the sentences of the paper that are judged."""
    entries = []
    for entry in _texts()["claim"]:
        entries.append(Sentence(**entry))
    return entries


def misprints() -> list[dict[str, str]]:
    """Read what the paper prints and does not mean: place, printed, meant, and what shows it."""
    return _texts()["misprint"]


def _texts() -> dict[str, list[dict[str, Value]]]:
    file = resources.files("reports.hbfd").joinpath("claims.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


def judge_all(published: Published) -> list[Claim]:
    """Judge every claim.

    Parameters
    ----------
    published : Published
        As `load_published` reads it.

    Returns
    -------
    list of Claim
        In the order of the paper, each with its verdict and the numbers it rests on.
    """
    return [judge(published, sentence) for sentence in sentences()]


def judge(published: Published, sentence: Sentence) -> Claim:
    """Judge one sentence by the function of its name; without cases it stays open."""
    judged = _judge_of(sentence)(published)
    verdict = verdict_of(judged.cases)
    fields: dict[str, Value] = {"p": published, "limit": Device(MASSES[-1], DAMPINGS[-1])}
    for name, value in judged.values.items():
        several = isinstance(value, list | tuple | dict)
        fields[name] = _Listed(value) if several else value
    numbers = _numbers(sentence, judged.values, fields)
    margin = None if verdict == "cannot be judged" else numbers.pop(0)
    conditional = verdict in ("holds only if", "cannot be judged")
    return Claim(
        verdict,
        sentence.condition.format(**fields) if conditional else "",
        sentence.finding.format(**fields),
        margin,
        tuple(numbers),
        sentence.name,
        sentence.place,
        sentence.quote,
    )


def _judge_of(sentence: Sentence) -> _Judge:
    """Return the function of a sentence's name; without one no number says anything."""
    function = sentence.name.replace("-", "_")
    for module in _MODULES:
        if hasattr(module, function):
            return getattr(module, function)
    return lambda published: evidence(None)


def _numbers(
    sentence: Sentence, values: Mapping[str, Value], fields: Mapping[str, Value]
) -> list[Quantity]:
    """Return the numbers under a sentence; a value that holds several gives one number for each."""
    numbers = []
    for name, path, unit in sentence.numbers:
        key, *attributes = path.split(".")
        value = values[key]
        for attribute in attributes:
            value = getattr(value, attribute)
        each = value if isinstance(value, dict) else {"": value}
        for of, number in each.items():
            numbers.append(Quantity(name.format(**fields, key=of), number, unit))
    return numbers
