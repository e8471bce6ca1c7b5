"""The folder of a batch: one file per finished study, each whole, and the table of all of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from percept.batch.rows import SCHEMA, Outcome, Status
from percept.errors import UsageError
from percept.files import exclusive, remove_abandoned, whole_file, write_whole

#: All studies in one table, in the order they were asked for.
TABLE_NAME = "batch.parquet"
# Studies per row group of that table: some ten thousand rows.
_GROUP = 128


class BatchFolder:
    """Results under DIR: ``studies/KEY.parquet``, ``failed/KEY.parquet`` and ``batch.parquet``.

    The first two digits of a key name a folder between, so that a million studies stay listable. Failed
    studies stand apart because they are tried again. To be used inside `opened`.

    Parameters
    ----------
    out : Path
        DIR.
    """

    def __init__(self, out: Path) -> None:
        self.out = out

    @classmethod
    @contextmanager
    def opened(cls, out: str | Path) -> Iterator[BatchFolder]:
        """Hold DIR, made where it does not exist, against other batches; remove what killed ones left.

        Raises
        ------
        UsageError
            Where it is no folder, cannot be written, or another batch is writing into it.
        """
        folder = cls(Path(out))
        with ExitStack() as held:
            with folder._writing():
                folder.out.mkdir(parents=True, exist_ok=True)
                try:
                    alone = held.enter_context(exclusive(folder.out, wait=False))
                except BlockingIOError:
                    raise UsageError(
                        "another batch is writing into this folder.",
                        file=str(out),
                        hint="Wait for it, or choose another --out.",
                    ) from None
                if alone:
                    for inside in (folder.out, *folder.out.glob("studies/*"), *folder.out.glob("failed/*")):
                        remove_abandoned(inside)
            yield folder

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except FileExistsError as error:
            raise UsageError(
                "a folder is needed here, and this is a file.", file=str(error.filename)
            ) from None
        except OSError as error:
            raise UsageError(
                f"cannot be written: {error.strerror}.",
                file=str(self.out),
                hint="What is finished is kept: make room or rights, and run the same command again.",
            ) from error

    def finished(self, key: str) -> bool:
        """Whether a study has its final rows."""
        return self._path("studies", key).exists()

    def verdict(self, key: str) -> tuple[Status, str | None]:
        """Return the status of a finished study and why it is not "done"."""
        kept = pq.ParquetFile(self._path("studies", key)).read(columns=["status", "message"])
        return kept["status"][0].as_py(), kept["message"][0].as_py()

    def save(self, key: str, outcome: Outcome) -> None:
        """Write the rows of a study; it is finished unless it failed.

        Raises
        ------
        UsageError
            Where they cannot be written.
        """
        place, other = ("failed", "studies") if outcome.status == "failed" else ("studies", "failed")
        path = self._path(place, key)
        with self._writing():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, outcome.table)
            self._path(other, key).unlink(missing_ok=True)

    def combine(self, keys: Iterable[str]) -> Path:
        """Write the rows of all studies asked for into one table, a few studies in memory at a time.

        Parameters
        ----------
        keys : iterable of str
            Of studies that were saved, in the order wanted.

        Returns
        -------
        Path
            ``DIR/batch.parquet``.

        Raises
        ------
        UsageError
            Where it cannot be written.
        """
        target = self.out / TABLE_NAME
        with (
            self._writing(),
            whole_file(target) as aside,
            pq.ParquetWriter(aside, SCHEMA, compression="zstd") as writer,
        ):
            group: list[pa.Table] = []
            for key in keys:
                group.append(self._read(key))
                if len(group) == _GROUP:
                    writer.write_table(pa.concat_tables(group))
                    group = []
            if group:
                writer.write_table(pa.concat_tables(group))
        return target

    def _read(self, key: str) -> pa.Table:
        place = "studies" if self.finished(key) else "failed"
        return pq.ParquetFile(self._path(place, key)).read()

    def _path(self, place: str, key: str) -> Path:
        return self.out / place / key[:2] / f"{key}.parquet"
