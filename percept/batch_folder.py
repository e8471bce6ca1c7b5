"""The folder of a batch: the rows of every finished study as CSV, and the table of all."""

from __future__ import annotations

import csv
import hashlib
import io
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pandas as pd

from percept.errors import UsageError
from percept.files import exclusive, whole_file, write_whole

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

# How the first line of a study's file begins, before the digest of the lines below it.
_SEAL = "# sha256 "
_HEADER = ",".join(COLUMNS) + "\n"
# The digests of the tables, by which percept tells its own folders and files.
_LISTING = "batch.sha256"
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
    return Outcome(status, message, rows.to_csv(index=False, lineterminator="\n"))


def failed(study: str, key: str, error: Exception) -> Outcome:
    """Encode the row of a study that met an error which is not about its data."""
    return encode(study, key, "failed", f"{type(error).__name__}: {error}")


@dataclass(frozen=True)
class Kept:
    """What an earlier run left of a study."""

    status: Status | Literal["damaged"]
    message: str


class _DamagedError(ValueError):
    """A file of rows is not what was written."""


class BatchFolder:
    """Results under DIR: ``studies/KEY.csv``, the table of all, and its digest.

    The first two digits of a key name a folder between, so that a million studies stay listable. To
    be used inside `opened`.
    """

    def __init__(self, out: Path) -> None:
        self.out = out

    @classmethod
    @contextmanager
    def opened(cls, out: str | Path) -> Iterator[BatchFolder]:
        """Hold DIR, made where it does not exist, against other batches."""
        folder = cls(Path(out))
        if folder.out.exists() and not folder.out.is_dir():
            raise UsageError("a folder is needed here, and this is a file.", file=str(out))
        folder.out.mkdir(parents=True, exist_ok=True)
        with exclusive(folder.out, wait=False):
            yield folder

    def kept(self, key: str) -> Kept | None:
        """Return what became of a study in an earlier run; None where it left nothing."""
        try:
            text = self._rows(key)
        except FileNotFoundError:
            return None
        except (_DamagedError, OSError) as damage:
            return Kept("damaged", str(damage))
        first = next(csv.DictReader(io.StringIO(text)))
        # The seal holds: the status is one that `encode` wrote.
        return Kept(first["status"], first["message"])  # type: ignore[arg-type]

    def save(self, key: str, outcome: Outcome) -> None:
        """Write the rows of a study; it is finished unless it failed."""
        path = self._path(key)
        path.parent.mkdir(parents=True, exist_ok=True)
        seal = f"{_SEAL}{_digest(outcome.text)}\n"
        write_whole(path, (seal + outcome.text).encode())

    def combine(self, keys: Sequence[str], table_format: TableFormat) -> Path:
        """Write the rows of saved studies into one table, in the order of the keys."""
        target = self.table(table_format)
        with whole_file(target) as aside:
            if table_format == "csv":
                self._write_csv(keys, aside)
            else:
                self._write_parquet(keys, aside)
            with aside.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            # First the list: a run that is killed before the next line leaves no table unlisted.
            self._list(target.name, digest)
        return target

    def table(self, table_format: TableFormat) -> Path:
        """Return the path of the table; refuse to replace one that no earlier batch wrote."""
        path = self.out / f"batch.{table_format}"
        if os.path.lexists(path) and path.name not in self._listed():
            raise UsageError(
                "it was not written by an earlier batch, and would be replaced.",
                file=str(path),
                hint="Rename it, or choose another folder.",
            )
        return path

    def _listed(self) -> dict[str, str]:
        """Return the digests of the tables by their names."""
        digests = {}
        with suppress(FileNotFoundError):
            for line in (self.out / _LISTING).read_text(encoding="utf-8").splitlines():
                digest, _, name = line.partition("  ")
                digests[name] = digest
        return digests

    def _list(self, name: str, digest: str) -> None:
        """Put the digest of a table into the list, in the form of ``sha256sum``."""
        digests = self._listed() | {name: digest}
        lines = [f"{digest}  {name}\n" for name, digest in sorted(digests.items())]
        write_whole(self.out / _LISTING, "".join(lines).encode())

    def _write_csv(self, keys: Sequence[str], path: Path) -> None:
        with path.open("w", encoding="utf-8", newline="") as file:
            file.write(_HEADER)
            for key in keys:
                file.write(self._saved(key).removeprefix(_HEADER))

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
                    self._saved(key).removeprefix(_HEADER) for key in keys[start : start + _GROUP]
                ]
                text = _HEADER + "".join(bodies)
                source = io.BytesIO(text.encode())
                writer.write_table(
                    pa_csv.read_csv(source, parse_options=parse, convert_options=convert)
                )

    def _path(self, key: str) -> Path:
        return self.out / "studies" / key[:2] / f"{key}.csv"

    def _rows(self, key: str) -> str:
        """Read the rows of a study, and hold them against their seal."""
        data = self._path(key).read_bytes()
        try:
            seal, _, text = data.decode().partition("\n")
        except UnicodeDecodeError as error:
            raise _DamagedError("it is no text") from error
        if seal != _SEAL + _digest(text):
            raise _DamagedError("its lines are not those that were written")
        return text

    def _saved(self, key: str) -> str:
        """Read the rows of a study that this run wrote or looked at."""
        try:
            return self._rows(key)
        except _DamagedError as damage:
            raise UsageError(
                f"it was damaged during this run: {damage}.",
                file=str(self._path(key)),
                hint="The same command again analyses this study again.",
            ) from damage


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
