"""A folder of finished runs, found by what they were asked."""

from __future__ import annotations

import dataclasses
import logging
import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from percept.cache.entry import DamagedEntry, decode, encode
from percept.cache.folder import cache_limit
from percept.cache.key import run_key
from percept.files import exclusive, remove_abandoned, shared, write_whole
from percept.inference.sampling.records import Run

_SUFFIX = ".run"
_log = logging.getLogger("percept.cache")


@dataclasses.dataclass(frozen=True)
class Entry:
    """One stored run.

    Attributes
    ----------
    key : str
        What it was asked, as a digest.
    size : int
        Bytes.
    used : int
        When it was last stored or found, ns; equal to the clock unless the clock went back.
    """

    key: str
    size: int
    used: int


class PosteriorCache:
    """Runs that were finished before, by content; safe to share between processes.

    An entry is written whole or not at all, carries a checksum, and is discarded with a message when it does
    not fit. Nothing here can fail an analysis: what cannot be read is computed, what cannot be written is
    said and left.

    Parameters
    ----------
    folder : Path
        Such as `cache_folder` gives; made when first written to.
    limit : int, optional
        Bytes, `cache_limit` by default; the entries not used for longest go first.
    """

    def __init__(self, folder: Path, *, limit: int | None = None) -> None:
        self.folder = folder
        self.limit = cache_limit() if limit is None else limit

    def run(self, asked: tuple[object, ...], compute: Callable[[], Run]) -> Run:
        """Return the stored run of what is asked, or compute and store it.

        Parameters
        ----------
        asked : tuple
            Model, estimands and settings; see `percept.cache.key.run_key`.
        compute : callable
            Gives the run where none is stored.

        Returns
        -------
        Run
            A stored one is equal to a computed one in every digit.
        """
        key = run_key(*asked)
        found = self.load(key)
        if found is None:
            found = compute()
            self.store(key, found)
        return found

    def load(self, key: str) -> Run | None:
        """Return a stored run; None where there is none or it was damaged and is now discarded."""
        path = self._path(key)
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            _log.warning("A stored posterior cannot be read (%s) and is computed again.", _why(error))
            return None
        try:
            run = decode(data)
        except DamagedEntry as damage:
            _log.warning("A stored posterior is damaged (%s): discarded, computed again.", damage)
            with suppress(OSError):
                path.unlink()
            return None
        self._stamp(path)
        _log.info("posterior %s found in %s", key[:12], self.folder)
        return run

    def store(self, key: str, run: Run) -> None:
        """Store a run, then remove what is beyond the limit; says so where it cannot."""
        path = self._path(key)
        data = encode(run)
        if len(data) > self.limit:
            _log.info("posterior %s takes %d bytes, more than the cache may", key[:12], len(data))
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with shared(self.folder):
                write_whole(path, data)
                self._stamp(path)
                self._evict(keep=path)
            with exclusive(self.folder, wait=False) as held:
                if held:
                    remove_abandoned(self.folder)
        except BlockingIOError:
            pass  # somebody else is writing, and will tidy up
        except OSError as error:
            _log.warning("The posterior was not kept for next time in %s: %s.", self.folder, _why(error))

    def entries(self) -> list[Entry]:
        """Return what is stored, the longest unused first."""
        found = []
        with suppress(FileNotFoundError), os.scandir(self.folder) as listing:
            for item in listing:
                if item.name.endswith(_SUFFIX) and not item.name.startswith("."):
                    with suppress(FileNotFoundError):
                        status = item.stat()
                        key = item.name.removesuffix(_SUFFIX)
                        found.append(Entry(key, status.st_size, status.st_mtime_ns))
        return sorted(found, key=lambda entry: (entry.used, entry.key))

    def clear(self) -> int:
        """Remove every entry and what killed processes left; return how many entries went.

        Raises
        ------
        OSError
            Where one cannot be removed.
        """
        if not self.folder.is_dir():
            return 0
        with exclusive(self.folder) as held:
            entries = self.entries()
            for entry in entries:
                self._path(entry.key).unlink(missing_ok=True)
            if held:
                remove_abandoned(self.folder)
        return len(entries)

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}{_SUFFIX}"

    def _stamp(self, path: Path) -> None:
        """Mark as last used: later than every other entry even where the clock has gone back."""
        latest = max((entry.used for entry in self.entries()), default=0)
        now = max(time.time_ns(), latest + 1)
        with suppress(OSError):  # gone by another process, or not ours to touch: its turn comes sooner
            os.utime(path, ns=(now, now))

    def _evict(self, *, keep: Path) -> None:
        entries = self.entries()
        total = sum(entry.size for entry in entries)
        for entry in entries:
            if total <= self.limit:
                break
            if self._path(entry.key) != keep:
                self._path(entry.key).unlink(missing_ok=True)
                total -= entry.size


def _why(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
