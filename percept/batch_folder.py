"""The folder of a batch: the rows of every finished study as CSV, and the table of all."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import pandas as pd

from percept.files import exclusive, inert, own_folder, whole_file, write_whole

__all__ = ["COLUMNS", "BatchFolder", "Kept", "Outcome", "Status", "TableFormat", "encode", "failed"]

#: A study is "done", or "refused" by the reader or the analysis. Where the gate failed it is
#: "withheld" and has classical rows only. "failed" is the fault of the machine or of an unreadable
#: file, and a later run tries again.
Status = Literal["done", "withheld", "refused", "failed"]
TableFormat = Literal["csv", "parquet"]

#: Columns of every result and their types: what became of the study, then its intervals in the unit
#: of their quantity, one row each. A study without intervals has one row.
COLUMNS = {
    "study": "text",
    "key": "text",
    "status": "text",
    "message": "text",
    "subjects": "count",
    "steps": "count",
    "worst_error": "real",
    "rhat": "real",
    "effective_draws": "real",
    "environment": "text",
    "parameter": "text",
    "kind": "text",
    "method": "text",
    "family": "text",
    "joint": "text",
    "level": "real",
    "share": "real",
    "confidence": "real",
    "lower": "real",
    "upper": "real",
    "estimate": "real",
    "n": "count",
    "unit": "text",
    "reference": "real",
}

_HEADER = ",".join(COLUMNS) + "\n"
# Studies per row group of a Parquet table: some ten thousand rows, which fit into any memory.
_GROUP = 128


@dataclass(frozen=True)
class Outcome:
    """What became of one study."""

    status: Status
    message: str  # Why, or the error of a study that misses its tolerance; empty where all is well
    text: str  # Its rows as CSV with a header: every number reads back as the same double


def encode(
    study: str, key: str, status: Status, message: str, rows: pd.DataFrame | None = None
) -> Outcome:
    """Encode the rows of a study: one per interval, or one without any."""
    if rows is None or rows.empty:
        rows = pd.DataFrame(index=[0])
    rows = rows.assign(study=study, key=key, status=status, message=message)
    whole = {name: "Int64" for name, kind in COLUMNS.items() if kind == "count"}
    rows = rows.reindex(columns=list(COLUMNS)).astype(whole)
    for name, kind in COLUMNS.items():
        if kind == "text":
            rows[name] = rows[name].map(inert, na_action="ignore")
    return Outcome(status, message, rows.to_csv(index=False, lineterminator="\n"))


def failed(study: str, key: str, error: Exception) -> Outcome:
    """Encode the row of a study that met an error which is not about its data."""
    return encode(study, key, "failed", f"{type(error).__name__}: {error}")


@dataclass(frozen=True)
class Kept:
    """What an earlier run left of a study."""

    status: Status
    message: str


class BatchFolder:
    """Results under DIR: ``studies/KEY.csv``, and the table of all.

    The first two digits of a key name a folder between, so that a million studies stay listable. To
    be used inside `opened`.
    """

    def __init__(self, out: Path) -> None:
        self.out = out

    @classmethod
    @contextmanager
    def opened(cls, out: str | Path, *, force: bool = False) -> Iterator[BatchFolder]:
        """Hold DIR, made where it does not exist, against other batches."""
        folder = cls(own_folder(out, force=force))
        with exclusive(folder.out, wait=False):
            yield folder

    def kept(self, key: str) -> Kept | None:
        """Return what became of a study in an earlier run; None where it left no rows of it."""
        try:
            rows = [*csv.DictReader(io.StringIO(self._rows(key)))]
        except (OSError, UnicodeDecodeError, csv.Error):
            return None
        first = rows[0] if rows else {}
        if first.get("key") != key or first.get("status") not in get_args(Status):
            return None
        return Kept(first["status"], first["message"])  # type: ignore[arg-type]

    def save(self, key: str, outcome: Outcome) -> None:
        """Write the rows of a study; it is finished unless it failed."""
        path = self._path(key)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, outcome.text.encode())

    def combine(self, keys: Sequence[str], table_format: TableFormat) -> Path:
        """Write the rows of saved studies into one table, in the order of the keys."""
        target = self.out / f"batch.{table_format}"
        with whole_file(target) as aside:
            if table_format == "csv":
                self._write_csv(keys, aside)
            else:
                self._write_parquet(keys, aside)
        return target

    def _write_csv(self, keys: Sequence[str], path: Path) -> None:
        with path.open("w", encoding="utf-8", newline="") as file:
            file.write(_HEADER)
            for key in keys:
                file.write(self._rows(key).removeprefix(_HEADER))

    def _write_parquet(self, keys: Sequence[str], path: Path) -> None:
        import pyarrow as pa
        import pyarrow.csv as pa_csv
        import pyarrow.parquet as pq

        types = {"text": pa.string(), "count": pa.int64(), "real": pa.float64()}
        schema = pa.schema([(name, types[kind]) for name, kind in COLUMNS.items()])
        # A message may have lines, and an environment may be called "NA".
        parse = pa_csv.ParseOptions(newlines_in_values=True)
        convert = pa_csv.ConvertOptions(
            column_types=schema, null_values=[""], strings_can_be_null=True
        )
        with pq.ParquetWriter(path, schema, compression="zstd") as writer:
            for start in range(0, len(keys), _GROUP):
                bodies = [
                    self._rows(key).removeprefix(_HEADER) for key in keys[start : start + _GROUP]
                ]
                text = _HEADER + "".join(bodies)
                source = io.BytesIO(text.encode())
                writer.write_table(
                    pa_csv.read_csv(source, parse_options=parse, convert_options=convert)
                )

    def _path(self, key: str) -> Path:
        return self.out / "studies" / key[:2] / f"{key}.csv"

    def _rows(self, key: str) -> str:
        """Read the rows of a study."""
        return self._path(key).read_bytes().decode()
