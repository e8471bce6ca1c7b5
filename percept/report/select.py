"""Find records of results by what they are, and name what a study is about."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from percept.results import Nouns, OverviewRow, Results
from percept.sessions.quantities import IMPEDANCE

__all__ = [
    "KINDS",
    "METHODS",
    "METHOD_NAMES",
    "MOST_NAMED",
    "MOST_OPEN",
    "Words",
    "choice_said",
    "chosen",
    "clearest",
    "compared_by_difference",
    "distinct",
    "each_by_itself",
    "families_of",
    "family_of",
    "first",
    "foremost",
    "gives_means",
    "is_rendered",
    "kind_names",
    "listed",
    "makes_impedance",
    "matching",
    "ordered",
    "preferred_families",
    "title_of",
    "words_of",
]  # fmt: skip

R = TypeVar("R")

#: Joint treatments of the main account: k and b each at the level asked for, or drawn together.
_EACH_BY_ITSELF = ("marginal", "joint")
KINDS = ("mean", "user", "share")
METHODS = ("classical", "bayesian")
METHOD_NAMES = {"classical": "classical", "bayesian": "Bayesian"}
#: More names than this are counted, not listed.
MOST_NAMED = 5
#: Of more environments the first screen has the clearest; all of them are a click away.
MOST_OPEN = 10


def kind_names(words: Nouns) -> dict[str, str]:
    """Name the kinds of interval in the study's word for users."""
    user, users = words.user
    return {"mean": f"average {user}", "user": f"next {user}", "share": f"share of {users}"}


def makes_impedance(results: Results) -> bool:
    """Say whether the study is of an impedance, so that haptics may be spoken of."""
    return results.data.quantities.keys() <= IMPEDANCE.keys()


def gives_means(results: Results) -> bool:
    """Say whether nothing was matched, so that biases from zero are the means themselves."""
    return not any(quantity.is_matched for quantity in results.data.quantities.values())


def title_of(results: Results) -> str:
    """Return the title of the page where the scene gives none."""
    if makes_impedance(results):
        return "Realistic performance boundaries"
    labels = [quantity.label for quantity in results.data.quantities.values()]
    return f"Intervals of {listed(labels)}"


@dataclass(frozen=True)
class Words:
    """What a study calls an environment, a subject and a user: one, and several."""

    environment: str
    environments: str
    subject: str
    subjects: str
    user: str
    users: str
    verb: str = "set"  # In the past tense

    @property
    def a_environment(self) -> str:
        """One environment, with its article."""
        return _with_article(self.environment)

    @property
    def a_subject(self) -> str:
        """One subject, with its article."""
        return _with_article(self.subject)


def _with_article(noun: str) -> str:
    article = "an" if noun.lower().startswith(tuple("aeiou")) else "a"
    return f"{article} {noun}"


def words_of(results: Results) -> Words:
    """Return the study's words."""
    nouns = results.data.words
    return Words(*nouns.environment, *nouns.subject, *nouns.user, nouns.verb)


def family_of(results: Results) -> str:
    """Return the family of the study's own model."""
    return str(results.provenance.scene["inference"]["family"])


def families_of(results: Results) -> tuple[str, ...]:
    """Return the families in order of preference, the study's own first."""
    return preferred_families(family_of(results))


def preferred_families(family: str) -> tuple[str, ...]:
    """Return the families in order of preference, a study's own first."""
    return tuple(dict.fromkeys((family, "lognormal", "normal")))


def is_rendered(results: Results, environment: str, *, coupled: bool) -> bool:
    """Say whether the device renders an environment with every hand, as far as that was asked."""
    if not results.rendering:
        return True
    return bool(
        matching(results.rendering, environment=environment, coupled=coupled, verdict="can")
    )


def distinct(records: Iterable[Any], name: str) -> list[Any]:
    """Return the different values of a field, in order of first appearance."""
    return list(dict.fromkeys(getattr(record, name) for record in records))


def each_by_itself(record: Any) -> bool:
    """Say whether a boundary is of the main account: not widened so that k and b hold together."""
    return record.joint in _EACH_BY_ITSELF


def compared_by_difference(records: Iterable[Any]) -> set[str]:
    """Return quantities with a reference of zero or below, to which there is no ratio."""
    parameters = set()
    for record in records:
        reference = record.reference
        if reference is not None and reference <= 0:
            parameters.add(record.parameter)
    return parameters


def matching(records: Iterable[R], **wanted: object) -> list[R]:
    """Return the records whose fields have these values."""
    return [
        record
        for record in records
        if all(getattr(record, name) == value for name, value in wanted.items())
    ]


def clearest(clarities: Mapping[str, float], most: int) -> set[str]:
    """Return the environments with the largest bias, each over its interval's length."""
    return set(sorted(clarities, key=lambda name: -clarities[name])[:most])


def foremost(rows: Sequence[OverviewRow]) -> set[str]:
    """Return the environments that stand open: of many those with the clearest bias."""
    names = distinct(rows, "environment")
    if len(names) <= MOST_OPEN:
        return set(names)
    clarities = dict.fromkeys(names, 0.0)
    for row in rows:
        if row.bias is None or row.bias_lower is None or row.bias_upper is None:
            continue
        clarity = abs(row.bias) / (row.bias_upper - row.bias_lower)
        clarities[row.environment] = max(clarity, clarities[row.environment])
    return clearest(clarities, max(1, MOST_OPEN // len(distinct(rows, "parameter"))))


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


def ordered(names: Iterable[str], records: Iterable[Any], field: str) -> list[str]:
    """Return the names that some record has."""
    present = {getattr(record, field) for record in records}
    return [name for name in names if name in present]


def listed(names: Sequence[str]) -> str:
    """Join names with commas and a final "and"."""
    return " and ".join(text for text in (", ".join(names[:-1]), *names[-1:]) if text)


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
