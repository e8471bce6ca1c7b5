"""Results as JSON values, and their one text form."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: A record or a mapping as JSON holds it.
JsonObject = dict[str, Any]

#: Characters that move a terminal's cursor or hide text: C1 controls, and marks of direction.
_HIDDEN = re.compile("[\x7f-\x9f\xad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff]")
_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)


def plain(value: Any) -> Any:
    """Turn a result into JSON values, with every digit; NaN is None, infinities are text."""
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return _number(float(value))
    if isinstance(value, Mapping):
        return {str(name): plain(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(part) for part in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    if hasattr(value, "model_dump"):
        return plain(value.model_dump())
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain_array(np.asarray(value))
    if hasattr(value, "to_dict"):
        return plain(value.to_dict("records"))
    raise TypeError(f"{type(value).__name__} has no plain form.")


def _plain_array(values: NDArray[Any]) -> Any:
    """Turn an array into lists; only where a number is not finite does each need a look."""
    if values.dtype.kind == "f" and np.isfinite(values).all():
        return values.tolist()
    return plain(values.tolist())


def _number(value: float) -> float | str | None:
    """Return a double as JSON holds it."""
    if math.isfinite(value):
        return value
    if math.isnan(value):
        return None
    return "inf" if value > 0 else "-inf"


def dumps(document: JsonObject) -> str:
    """Write a plain document as JSON: full precision, stable order, readable, one final newline.

    Parameters
    ----------
    document : mapping
        As `plain` returns it.

    Returns
    -------
    str
        Lists of numbers stand on one line. Characters that a terminal would obey are escaped.

    Raises
    ------
    ValueError
        Where a NaN or an infinity is left.
    """
    text = _indented(document, "") + "\n"
    # They stand in texts only.
    return _HIDDEN.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def _indented(value: Any, indent: str) -> str:
    """Write dicts, and lists of lists or dicts, an entry a line; lists of numbers stay on one."""
    deeper = indent + " "
    if isinstance(value, dict) and value:
        entries = [
            f"{_ENCODER.encode(name)}: {_indented(part, deeper)}" for name, part in value.items()
        ]
    elif isinstance(value, list) and any(isinstance(part, (dict, list)) for part in value):
        entries = [_indented(part, deeper) for part in value]
    else:
        return _ENCODER.encode(value)
    first, last = "{}" if isinstance(value, dict) else "[]"
    return f"{first}\n" + ",\n".join(deeper + entry for entry in entries) + f"\n{indent}{last}"
