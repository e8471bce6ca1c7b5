"""A claim of the paper: the sentence as printed, its verdict, and the numbers the verdict rests on.

`claims.toml` holds the sentences and what is said of each. A function of the claim's name gives the
cases that decide the verdict, and the values that stand in the text.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

import numpy as np

from percept.report.numbers import rounded
from percept.reproduce import claims_coupling, claims_figures, claims_table
from percept.reproduce.published import Published

Verdict = Literal["holds", "holds only if", "does not hold", "cannot be judged"]


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
        text = f"{self.value:.0f}" if float(self.value).is_integer() else rounded(self.value)
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
    source: str  # The function or command that gives the numbers


class _Many:
    """Several values in a sentence: names with "and", numbers by their format, each with what it is of."""

    def __init__(self, values: Any) -> None:
        self._values = values

    def __format__(self, spec: str) -> str:
        if isinstance(self._values, Mapping):
            return ", ".join(f"{value:{spec}} ({name})" for name, value in self._values.items())
        *first, last = [format(value, spec) for value in self._values] or ["none"]
        return ", ".join([*first, last]) if spec or not first else f"{', '.join(first)} and {last}"

    def __getitem__(self, index: int) -> Any:
        return self._values[index]


def verdict_of(cases: Iterable[bool] | None) -> Verdict:
    """Judge a sentence: it holds if it is true in all cases, does not if in none, else on a condition."""
    if cases is None:
        return "cannot be judged"
    true = [bool(case) for case in cases]
    return "holds" if all(true) else "holds only if" if any(true) else "does not hold"


def sentences() -> dict[str, Any]:
    """Read the sentences of the paper that are judged, and its misprints."""
    text = resources.files("percept.reproduce").joinpath("claims.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


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
    return [judge(published, entry) for entry in sentences()["claim"]]


def judge(published: Published, entry: Mapping[str, Any]) -> Claim:
    """Judge one sentence by the function of its name; without cases it stays open."""
    function = entry["name"].replace("-", "_")
    module = next(
        (m for m in (claims_coupling, claims_figures, claims_table) if hasattr(m, function)), None
    )
    values = getattr(module, function)(published) if module else {}
    verdict = verdict_of(values.get("cases"))
    many = {
        n: _Many(v) for n, v in values.items() if isinstance(v, (list, tuple, dict, np.ndarray))
    }
    said = {"p": published, **values, **many}
    numbers = []
    for name, key, unit in entry.get("numbers", ()):
        each = values[key] if isinstance(values[key], dict) else {"": values[key]}
        numbers += [
            Quantity(name.format(**said, key=of), value, unit) for of, value in each.items()
        ]
    stated = verdict in ("holds only if", "cannot be judged")
    return Claim(
        verdict,
        entry["condition"].format(**said) if stated else "",
        entry["finding"].format(**said),
        None if verdict == "cannot be judged" else numbers.pop(0),
        tuple(numbers),
        **{name: entry[name] for name in ("name", "place", "quote", "source")},
    )
