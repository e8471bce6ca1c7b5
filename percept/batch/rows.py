"""The rows a study leaves behind, as a table of one schema whatever became of it."""

from __future__ import annotations

import dataclasses
import io
from typing import Any, Literal

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

Status = Literal["done", "withheld", "refused", "failed"]

_TEXT, _REAL, _COUNT = pa.string(), pa.float64(), pa.int64()

#: Columns of every result: what became of the study, then its intervals in N/m and N·s/m, one row each; a
#: study without intervals has one row. `status` is "done", "withheld" (the gate failed: classical rows only),
#: "refused" (the reader or the analysis says no) or "failed" (the machine, or a file that cannot be read: a
#: later run tries again).
SCHEMA = pa.schema(
    [
        ("study", _TEXT), ("key", _TEXT), ("status", _TEXT), ("message", _TEXT), ("subjects", _COUNT),
        ("steps", _COUNT), ("worst_error", _REAL), ("rhat", _REAL), ("effective_draws", _REAL),
        ("environment", _TEXT), ("parameter", _TEXT), ("kind", _TEXT), ("method", _TEXT), ("family", _TEXT),
        ("joint", _TEXT), ("level", _REAL), ("share", _REAL), ("confidence", _REAL), ("lower", _REAL),
        ("upper", _REAL), ("estimate", _REAL), ("n", _COUNT), ("unit", _TEXT), ("reference", _REAL),
    ]
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of one study."""

    status: Status  # "done", "withheld", "refused" or "failed"
    message: str | None  # Why, or the error of a study that misses its tolerance
    table: bytes  # Its rows as Parquet
    seconds: float  # Time the analysis took


def to_parquet(shared: dict[str, Any], intervals: pd.DataFrame | None = None) -> bytes:
    """Encode the rows of a study."""
    rows: list[dict[str, Any]] = [{}]
    if intervals is not None and len(intervals):
        rows = intervals.to_dict("records")  # type: ignore[assignment]
    columns = {
        field.name: pa.array([_value({**row, **shared}.get(field.name)) for row in rows], type=field.type)
        for field in SCHEMA
    }
    target = io.BytesIO()
    pq.write_table(pa.table(columns, schema=SCHEMA), target, compression="zstd")
    return target.getvalue()


def _value(value: Any) -> Any:
    """Turn a DataFrame's NaN, a missing number, into null."""
    return None if isinstance(value, float) and value != value else value
