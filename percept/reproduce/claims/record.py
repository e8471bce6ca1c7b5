"""A claim of the paper, and what its own numbers say about it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from percept.report.numbers import rounded

Verdict = Literal["holds", "holds only if", "does not hold"]


@dataclass(frozen=True)
class Quantity:
    """A number a verdict rests on.

    Attributes
    ----------
    name : str
        What it is, in a few words.
    value : float
        With all its digits.
    unit : str
        Empty where it has none; ``"1"`` where the value is a fraction, which is read as a percentage.
    """

    name: str
    value: float
    unit: str = ""

    @property
    def text(self) -> str:
        """The value as it is read, with its unit."""
        if self.unit == "1":
            return f"{rounded(100 * self.value, 4)} %"
        text = f"{self.value:.0f}" if float(self.value).is_integer() else rounded(self.value)
        return f"{text} {self.unit}".rstrip()


@dataclass(frozen=True)
class Claim:
    """A claim and its verdict.

    Attributes
    ----------
    name : str
        Short, unique.
    place : str
        Where in the paper.
    paper : str
        What it says, in our words.
    verdict : {"holds", "holds only if", "does not hold"}
        Follows from `numbers`.
    condition : str
        What "only if" asks for; empty otherwise.
    finding : str
        What was found.
    margin : Quantity
        By how much the verdict is decided.
    numbers : tuple of Quantity
        What else it rests on.
    source : str
        The function or command that gives the numbers.
    """

    name: str
    place: str
    paper: str
    verdict: Verdict
    condition: str
    finding: str
    margin: Quantity
    numbers: tuple[Quantity, ...]
    source: str

    @classmethod
    def judged(
        cls,
        name: str,
        *,
        place: str,
        paper: str,
        cases: Iterable[bool],
        condition: str = "",
        finding: str,
        margin: Quantity,
        numbers: Iterable[Quantity] = (),
        source: str,
    ) -> Claim:
        """Make a claim whose verdict is that of its cases.

        Parameters
        ----------
        cases : iterable of bool
            Everything the claim speaks of: true in all, in some, in none.
        condition : str
            Kept where the claim is true in some.
        name, place, paper, finding, margin, numbers, source
            As `Claim`.

        Returns
        -------
        Claim
        """
        verdict = _verdict_of(cases)
        kept = condition if verdict == "holds only if" else ""
        return cls(name, place, paper, verdict, kept, finding, margin, tuple(numbers), source)


def _verdict_of(cases: Iterable[bool]) -> Verdict:
    """Return what a claim is worth that is true in some cases."""
    found = [bool(case) for case in cases]
    if all(found):
        return "holds"
    return "holds only if" if any(found) else "does not hold"


def listed(names: Sequence[str]) -> str:
    """Return names as a sentence lists them; "none" without any."""
    if not names:
        return "none"
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
