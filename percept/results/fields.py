"""Types of fields that JSON holds in another form than the record does."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator

Feeling: TypeAlias = Literal["feels real", "does not", "too little data"]
Inside: TypeAlias = Literal["inside", "marginal", "outside"]


def _as_floats(values: Any) -> NDArray[np.float64]:
    """Read a list of a document: "inf" is infinite, and None is NaN."""
    if isinstance(values, np.ndarray):
        return values.astype(np.float64, copy=False)
    if not isinstance(values, list):
        raise ValueError("a list of numbers was expected")
    if values and isinstance(values[0], list):
        return np.array([_as_floats(row) for row in values], dtype=np.float64)
    return np.array([np.nan if value is None else float(value) for value in values])


#: An array of doubles; in JSON a list, or a list of lists.
Array = Annotated[NDArray[np.float64], PlainValidator(_as_floats)]
