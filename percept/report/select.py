"""Find records of results by what they are, and name what a study is about."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

from percept.report.numbers import listed
from percept.results import IntervalRow, Results
from percept.sessions.quantities import IMPEDANCE

R = TypeVar("R")

KINDS = ("mean", "user", "share")
METHODS = ("classical", "bayesian")
METHOD_NAMES = {"classical": "classical", "bayesian": "Bayesian"}
#: Joint treatments of the main account: k and b each at the level asked for, or drawn together.
_UNWIDENED = ("marginal", "joint")
#: Environments that stand open and in figures; tables have all of more.
MOST_SHOWN = 10


def makes_impedance(results: Results) -> bool:
    """Say whether the study is of an impedance, so that haptics may be spoken of."""
    return results.data.quantities.keys() <= IMPEDANCE.keys()


def gives_means(results: Results) -> bool:
    """Say whether nothing was matched, so that biases from zero are the means themselves."""
    return not any(quantity.is_matched for quantity in results.data.quantities.values())


def is_relative(intervals: Iterable[IntervalRow], parameter: str) -> bool:
    """Say whether all references are positive, so that a bias is a fraction of its reference."""
    rows = matching(intervals, parameter=parameter)
    return all(row.reference is None or row.reference > 0 for row in rows)


def title_of(results: Results) -> str:
    """Return the title of the page where the scene gives none."""
    if makes_impedance(results):
        return "Realistic performance boundaries"
    labels = [quantity.label for quantity in results.data.quantities.values()]
    return f"Intervals of {listed(labels)}"


def family_of(results: Results) -> str:
    """Return the family of the study's own model."""
    return str(results.provenance.scene["inference"]["family"])


def families_from(family: str) -> tuple[str, ...]:
    """Return the families in order of preference, a study's own first."""
    return tuple(dict.fromkeys((family, "lognormal", "normal")))


def is_rendered(results: Results, environment: str, *, coupled: bool) -> bool:
    """Say whether the device renders an environment with every hand, as far as that was asked."""
    rows = matching(results.rendering or (), environment=environment, coupled=coupled)
    return not results.rendering or bool(matching(rows, verdict="can"))


def distinct(records: Iterable[Any], name: str) -> list[Any]:
    """Return the different values of a field, in order of first appearance."""
    return list(dict.fromkeys(getattr(record, name) for record in records))


def matching(records: Iterable[R], **wanted: object) -> list[R]:
    """Return the records whose fields have these values."""
    return [
        record
        for record in records
        if all(getattr(record, name) == value for name, value in wanted.items())
    ]


def unwidened(records: Iterable[R]) -> list[R]:
    """Return the records of the main account: not widened so that k and b hold together."""
    return [record for record in records if getattr(record, "joint", "") in _UNWIDENED]


def present(names: Iterable[str], records: Iterable[Any], field: str) -> list[str]:
    """Return the names that some record has, in their order."""
    found = {getattr(record, field) for record in records}
    return [name for name in names if name in found]


def first(records: Iterable[R], **preferred: Sequence[object]) -> R | None:
    """Return the record that stands highest in every preference, earlier fields weighing more."""

    def ranks(record: R) -> list[int]:
        return [values.index(getattr(record, name)) for name, values in preferred.items()]

    accepted = [
        record
        for record in records
        if all(getattr(record, name) in values for name, values in preferred.items())
    ]
    return min(accepted, key=ranks, default=None)
