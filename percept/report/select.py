"""Find records of a document by what they are, in order of preference."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Record = Mapping[str, Any]

#: Joint treatments of the main account: k and b each at the level asked for, or drawn together.
EACH_BY_ITSELF = ("marginal", "joint")
KINDS = ("mean", "user", "share")
METHODS = ("classical", "bayesian")
METHOD_NAMES = {"classical": "classical", "bayesian": "Bayesian"}


def family_of(document: Mapping[str, Any]) -> str:
    """Return the family of the study's own model."""
    scene = document["provenance"]["scene"]
    return str(scene.get("inference", {}).get("family", "lognormal"))


def array(values: Sequence[Any] | None) -> NDArray[np.float64]:
    """Return a list of the document as floats: "inf" is infinite, None is NaN, no list is empty."""
    return np.array([np.nan if value is None else float(value) for value in values or ()], dtype=float)


def distinct(records: Iterable[Record], name: str) -> list[Any]:
    """Return the different values of a field, in order of first appearance."""
    return list(dict.fromkeys(record[name] for record in records))


def each_by_itself(record: Record) -> bool:
    """Say whether a boundary is of the main account: not widened so that k and b hold together."""
    return record["joint"] in EACH_BY_ITSELF


def matching(records: Iterable[Record], **wanted: Any) -> list[Record]:
    """Return the records whose fields have these values."""
    return [record for record in records if all(record.get(name) == value for name, value in wanted.items())]


def first(records: Iterable[Record], **preferred: Sequence[Any]) -> Record | None:
    """Return the record that stands highest in every preference, earlier fields weighing more."""
    accepted = [
        record for record in records if all(record.get(name) in values for name, values in preferred.items())
    ]
    return min(
        accepted,
        key=lambda record: [list(values).index(record[name]) for name, values in preferred.items()],
        default=None,
    )
