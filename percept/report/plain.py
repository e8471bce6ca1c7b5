"""Records, arrays and tables as plain JSON values, and their one text form."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["dumps", "plain"]


def plain(value: Any) -> Any:
    """Turn a result into what JSON can hold, without losing a digit.

    Parameters
    ----------
    value : object
        None, text, number, array, DataFrame, mapping, sequence, dataclass or pydantic model, nested at will.

    Returns
    -------
    object
        Dicts, lists, text, numbers, booleans and None only. Infinities become ``"inf"`` and ``"-inf"``, NaN
        becomes None, a DataFrame a list of its rows, a complex number ``[real, imaginary]``.

    Raises
    ------
    TypeError
        Where a value has no plain form.
    """
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


def dumps(document: Mapping[str, Any]) -> str:
    """Write a plain document as JSON: full precision, stable order, readable, one final newline.

    Parameters
    ----------
    document : mapping
        As `plain` returns it.

    Returns
    -------
    str
        Lists of numbers stand on one line.

    Raises
    ------
    ValueError
        Where a NaN or an infinity is left.
    """
    return _written(document, "") + "\n"


def _real(value: float) -> float | str | None:
    if math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value


def _written(value: Any, indent: str) -> str:
    nested = isinstance(value, (dict, list)) and any(
        isinstance(part, (dict, list)) for part in (value.values() if isinstance(value, dict) else value)
    )
    if not nested and not isinstance(value, dict):
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    deeper = indent + " "
    if isinstance(value, dict):
        parts = [
            f"{deeper}{json.dumps(name, ensure_ascii=False)}: {_written(part, deeper)}"
            for name, part in value.items()
        ]
        return "{\n" + ",\n".join(parts) + f"\n{indent}}}" if parts else "{}"
    return "[\n" + ",\n".join(deeper + _written(part, deeper) for part in value) + f"\n{indent}]"
