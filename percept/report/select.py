"""Find records of a document by what they are, and the numbers in them by their JSON pointer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.results import Nouns, Results
from percept.sessions.quantities import IMPEDANCE, Quantity

__all__ = [
    "KINDS", "METHODS", "METHOD_NAMES", "STATISTICS", "Record", "Section", "Words", "array", "at",
    "choice_said", "chosen", "compared_by_difference", "distinct", "each_by_itself", "escaped",
    "families_of", "family_of", "first", "kind_names", "listed", "makes_impedance", "matching",
    "ordered", "pointed", "preferred_families", "quantities_of", "title_of", "unescaped", "words_of",
]  # fmt: skip

Record = Mapping[str, Any]
R = TypeVar("R")

#: Joint treatments of the main account: k and b each at the level asked for, or drawn together.
_EACH_BY_ITSELF = ("marginal", "joint")
KINDS = ("mean", "user", "share")
METHODS = ("classical", "bayesian")
#: Statistics of the predictive check, in words.
STATISTICS = {"mean": "mean", "sd": "SD", "farthest": "farthest {subject}"}
METHOD_NAMES = {"classical": "classical", "bayesian": "Bayesian"}


@dataclass(frozen=True)
class Section:
    """A section of the page."""

    name: str  # Id on the page, and name of its template
    title: str  # Heading
    values: Record  # What the template reads


def kind_names(words: Nouns | Record) -> dict[str, str]:
    """Name the kinds of interval in the study's word for users."""
    user, users = _field(words, "user")
    return {"mean": f"average {user}", "user": f"next {user}", "share": f"share of {users}"}


def quantities_of(document: Record) -> dict[str, Quantity]:
    """Return what the study adjusted, by name."""
    return {name: Quantity(**record) for name, record in document["data"]["quantities"].items()}


def makes_impedance(document: Record) -> bool:
    """Say whether the study is of an impedance, so that haptics may be spoken of."""
    return document["data"]["quantities"].keys() <= IMPEDANCE.keys()


def title_of(document: Record) -> str:
    """Return the title of the page where the scene gives none."""
    if makes_impedance(document):
        return "Realistic performance boundaries"
    return f"Intervals of {' and '.join(q.label for q in quantities_of(document).values())}"


@dataclass(frozen=True)
class Words:
    """What a study calls an environment, a subject and a user: one, and several."""

    environment: str
    environments: str
    subject: str
    subjects: str
    user: str
    users: str


def words_of(results: Results | Record) -> Words:
    """Return the study's words."""
    nouns = _field(_field(results, "data"), "words")
    environment, environments = _field(nouns, "environment")
    subject, subjects = _field(nouns, "subject")
    user, users = _field(nouns, "user")
    return Words(environment, environments, subject, subjects, user, users)


def family_of(results: Results | Record) -> str:
    """Return the family of the study's own model."""
    scene = _field(_field(results, "provenance"), "scene")
    return str(scene.get("inference", {}).get("family", "lognormal"))


def families_of(results: Results | Record) -> tuple[str, ...]:
    """Return the families in order of preference, the study's own first."""
    return preferred_families(family_of(results))


def preferred_families(family: str) -> tuple[str, ...]:
    """Return the families in order of preference, a study's own first."""
    return tuple(dict.fromkeys((family, "lognormal", "normal")))


def array(values: Sequence[Any] | None) -> NDArray[np.float64]:
    """Return a list of the document as floats: "inf" is infinite, None is NaN, no list is empty."""
    return np.array(
        [np.nan if value is None else float(value) for value in values or ()], dtype=float
    )


def _field(record: Any, name: str) -> Any:
    """Return a field of a record; None where it has none of this name."""
    return record.get(name) if isinstance(record, Mapping) else getattr(record, name, None)


def distinct(records: Iterable[Any], name: str) -> list[Any]:
    """Return the different values of a field, in order of first appearance."""
    return list(dict.fromkeys(_field(record, name) for record in records))


def each_by_itself(record: Any) -> bool:
    """Say whether a boundary is of the main account: not widened so that k and b hold together."""
    return _field(record, "joint") in _EACH_BY_ITSELF


def compared_by_difference(records: Iterable[Any]) -> set[str]:
    """Return quantities with a reference of zero or below: a ratio to it would turn round or fail."""
    parameters = set()
    for record in records:
        reference = _field(record, "reference")
        if reference is not None and reference <= 0:
            parameters.add(_field(record, "parameter"))
    return parameters


def matching(records: Iterable[R], **wanted: object) -> list[R]:
    """Return the records whose fields have these values."""
    return [
        record
        for record in records
        if all(_field(record, name) == value for name, value in wanted.items())
    ]


#: Most environments of a figure: more are strips that nobody reads, on a page of many megabytes.
MOST_DRAWN = 24


def chosen(names: Sequence[str]) -> list[str]:
    """Return the environments that a figure draws: all, or some evenly spaced in their order."""
    if len(names) <= MOST_DRAWN:
        return list(names)
    places = np.linspace(0, len(names) - 1, MOST_DRAWN).round().astype(int)
    return [names[place] for place in places]


def choice_said(names: Sequence[str], environments: str) -> str:
    """Say that a figure leaves environments out; nothing where it draws them all."""
    if len(names) <= MOST_DRAWN:
        return ""
    return (
        f" {MOST_DRAWN} of {len(names)} {environments} are drawn, evenly spaced in their order. The"
        " tables hold all."
    )


def ordered(names: Iterable[str], rows: Iterable[Record], field: str) -> list[str]:
    """Return the names that some row has."""
    present = {row[field] for row in rows}
    return [name for name in names if name in present]


def listed(names: Sequence[str]) -> str:
    """Join names with commas and a final "and"."""
    return " and ".join(text for text in (", ".join(names[:-1]), *names[-1:]) if text)


def first(records: Iterable[R], **preferred: Sequence[object]) -> R | None:
    """Return the record that stands highest in every preference, earlier fields weighing more."""

    def ranks(record: R) -> list[int]:
        return [values.index(_field(record, name)) for name, values in preferred.items()]

    accepted = [
        record
        for record in records
        if all(_field(record, name) in values for name, values in preferred.items())
    ]
    return min(accepted, key=ranks, default=None)


def pointed(records: Iterable[Record] | None, root: str) -> list[dict[str, Any]]:
    """Return records with the JSON pointer of each, from that of their list."""
    return [{**record, "pointer": f"{root}/{index}"} for index, record in enumerate(records or ())]


def escaped(name: str) -> str:
    """Write a name as a step of a JSON pointer."""
    return name.replace("~", "~0").replace("/", "~1")


def unescaped(step: str) -> str:
    """Read a step of a JSON pointer."""
    return step.replace("~1", "/").replace("~0", "~")


def at(document: Any, pointer: str) -> Any:
    """Return what stands at a JSON pointer."""
    value = document
    try:
        for step in pointer.split("/")[1:]:
            value = value[int(step)] if isinstance(value, list) else value[unescaped(step)]
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise UsageError("the report has nothing at this place.", value=pointer) from error
    return value
