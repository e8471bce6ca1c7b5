"""Records, arrays and tables as plain JSON values, and their one text form."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)


class Digits(dict[float, str]):
    """Shortest text of each double that reads back to it, worked out once however often it is written.

    Grids and references stand in a document for one curve after another, and in its tables again.
    """

    def __missing__(self, value: float) -> str:
        text = repr(value)
        if value:
            # Zero and minus zero would be the same key.
            self[value] = text
        return text

    def of(self, values: Iterable[float]) -> Iterator[str]:
        """Give the texts of several doubles."""
        return map(self.__getitem__, values)


def plain(value: Any) -> Any:
    """Turn a result into what JSON can hold, without losing a digit."""
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return _real(float(value))
    if isinstance(value, complex):
        return [_real(value.real), _real(value.imag)]
    if isinstance(value, Mapping):
        return {str(name): plain(part) for name, part in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(part) for part in (sorted(value) if isinstance(value, (set, frozenset)) else value)]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray) and value.dtype.kind == "f" and np.isfinite(value).all():
        return value.tolist()
    for method in ("model_dump", "tolist"):
        if hasattr(value, method):
            return plain(getattr(value, method)())
    if hasattr(value, "to_dict"):
        return [plain(row) for row in value.to_dict("records")]
    raise TypeError(f"{type(value).__name__} has no plain form.")


def dumps(document: Mapping[str, Any], *, digits: Digits | None = None) -> str:
    """Write a plain document as JSON: full precision, stable order, readable, one final newline.

    Parameters
    ----------
    document : mapping
        As `plain` returns it.
    digits : Digits, optional
        Texts known already.

    Returns
    -------
    str
        Lists of numbers stand on one line.

    Raises
    ------
    ValueError
        Where a NaN or an infinity is left.
    """
    return _written(document, "", Digits() if digits is None else digits) + "\n"


def _real(value: float) -> float | str | None:
    if math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value


def _written(value: Any, indent: str, digits: Digits) -> str:
    if isinstance(value, dict) and value:
        deeper = indent + " "
        parts = [f"{deeper}{_text(name)}: {_written(part, deeper, digits)}" for name, part in value.items()]
        return "{\n" + ",\n".join(parts) + f"\n{indent}}}"
    if isinstance(value, list):
        kinds = set(map(type, value))
        if kinds == {float}:
            return _numbers(value, digits)
        if dict in kinds or list in kinds:
            deeper = indent + " "
            parts = [deeper + _written(part, deeper, digits) for part in value]
            return "[\n" + ",\n".join(parts) + f"\n{indent}]"
    return _text(value)


def _text(value: Any) -> str:
    return _ENCODER.encode(value)


def _numbers(values: list[float], digits: Digits) -> str:
    text = f"[{', '.join(digits.of(values))}]"
    # Of all doubles only nan and inf are written with a letter n; JSON has no word for them.
    return _text(values) if "n" in text else text
