"""Values inside cells: JSON records and lists by a dotted path, as text, so that no digit is lost."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from typing import Any

from percept.sessions.numbers import is_missing

_NUMPY = re.compile(r"np\.(?:float|int)\d+\(([^()]*)\)")


class CellError(ValueError):
    """A cell that has no value at the path asked for."""


class NoKeyError(CellError):
    """A record without a key of the path; `keys` are those it has."""

    def __init__(self, step: str, keys: Iterable[str]) -> None:
        super().__init__(f"the record has no {step!r}")
        self.keys = tuple(keys)


def pick(cell: str, path: str) -> str:
    """Pick one value from a JSON cell."""
    if is_missing(cell):
        return ""
    text = _NUMPY.sub(r"\1", cell)
    try:
        value = json.loads(
            text, parse_float=str, parse_int=str, parse_constant=str, object_pairs_hook=_unique
        )
    except (json.JSONDecodeError, RecursionError):
        raise CellError("not a JSON record or list") from None
    for step in path.split("."):
        value = _step(value, step)
    if value is None:
        return ""
    if not isinstance(value, str):
        raise CellError(f"{path!r} leads to a record, a list or true/false, not to a number")
    return value


def _step(value: Any, step: str) -> Any:
    if isinstance(value, dict):
        if step not in value:
            raise NoKeyError(step, value)
        return value[step]
    if isinstance(value, list) and re.fullmatch(r"-?[0-9]{1,9}", step):
        at = int(step)
        if -len(value) <= at < len(value):
            return value[at]
        raise CellError(f"the list has no item {step}")
    if value is None:
        return None
    raise CellError(f"there is no {step!r} in it")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    record = dict(pairs)
    if len(record) < len(pairs):
        raise CellError("a key stands twice in the record")
    return record
