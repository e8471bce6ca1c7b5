"""Run a batch: hand out studies a few ahead of the workers, keep what comes back as it comes."""

from __future__ import annotations

import asyncio
import concurrent.futures
import dataclasses
import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from percept.batch.folder import BatchFolder
from percept.batch.inputs import StudyFiles, StudySource
from percept.batch.rows import Outcome
from percept.batch.work import analyse, nothing_read
from percept.errors import PerceptError, RefusalError

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["Summary", "run_batch"]

# Studies handed out per worker thread: one at work, one waiting there. More would only fill memory.
_AHEAD = 2
# How often a result may be lost with the worker that held it before the study counts as failed.
_LOSSES = 3


@dataclasses.dataclass(frozen=True)
class Summary:
    """What a batch came to.

    Attributes
    ----------
    table : Path
        The table of all studies.
    studies : int
        How many were asked for.
    skipped : int
        Of them, how many an earlier run had finished.
    counts : dict of str to int
        Of those analysed now, how many ended in each status.
    failures : tuple of (str, str)
        Name and message of each study that was refused or failed now.
    seconds : float
        Sum of the workers' times.
    """

    table: Path
    studies: int
    skipped: int
    counts: dict[str, int]
    failures: tuple[tuple[str, str], ...]
    seconds: float


def run_batch(
    studies: Sequence[StudySource],
    out: str | Path,
    client: Client,
    *,
    progress: Callable[[int, int, int], None] | None = None,
) -> Summary:
    """Analyse studies on a cluster; the rows depend on the studies, not on the workers.

    Parameters
    ----------
    studies : sequence of StudySource
        The studies, as `percept.batch.sources` gives them.
    out : str or Path
        Folder of the results. Studies it holds with the same content, scene and version are skipped.
    client : distributed.Client
        Connected; see `percept.batch.connected`.
    progress : callable, optional
        Told how many studies are finished, of how many, and how many were refused or failed.

    Returns
    -------
    Summary

    Raises
    ------
    UsageError
        Where `out` cannot be written or another batch is writing there.
    RefusalError
        Where the scheduler was lost; what is finished is kept.
    """
    with BatchFolder.opened(out) as folder:
        batch = _Batch(studies, folder, client, progress)
        batch.run()
        return batch.summary(folder.combine(batch.keys))


@dataclasses.dataclass(frozen=True)
class _Given:
    """A study that was handed out: what is at work on it, and for the how many-th time."""

    files: StudyFiles
    attempt: int


class _Batch:
    """The state of a run: what is handed out, and what came back."""

    def __init__(
        self,
        studies: Sequence[StudySource],
        folder: BatchFolder,
        client: Client,
        progress: Callable[[int, int, int], None] | None,
    ) -> None:
        self._studies = studies
        self._folder = folder
        self._client = client
        self._tell = progress or (lambda done, studies, failed: None)
        self._waiting = iter(studies)
        self._out: dict[Future, _Given] = {}
        self._skipped = 0
        self._counts: Counter[str] = Counter()
        self._failures: list[tuple[str, str]] = []
        self._seconds = 0.0
        self.keys: list[str] = []

    def run(self) -> None:
        """Analyse every study that is not finished."""
        from distributed import as_completed

        done = as_completed(loop=self._client.loop)
        while True:
            while len(self._out) < _AHEAD * max(1, self._threads()):
                files = self._next()
                if files is None:
                    break
                done.add(self._hand_out(_Given(files, 1)))
            if not self._out:
                return
            again = self._take_back(next(done))
            if again is not None:
                done.add(self._hand_out(again))

    def summary(self, table: Path) -> Summary:
        """Return what the run came to."""
        return Summary(
            table, len(self._studies), self._skipped, dict(self._counts), tuple(self._failures), self._seconds
        )

    def _threads(self) -> int:
        try:
            return sum(self._client.nthreads().values())
        except OSError as error:  # what dask calls a closed connection
            raise _lost() from error

    def _next(self) -> StudyFiles | None:
        """Return the next study that needs analysing; None when there is none."""
        for study in self._waiting:
            try:
                files = study.read()
            except PerceptError as error:
                key = hashlib.sha256(f"unread {study.path}".encode()).hexdigest()
                self.keys.append(key)
                self._keep(study.path, key, nothing_read(study.path, key, str(error), status="failed"))
                continue
            self.keys.append(files.key)
            if not self._folder.finished(files.key):
                return files
            self._skipped += 1
            self._report()
        return None

    def _hand_out(self, given: _Given) -> Future:
        name = f"percept-{given.files.key}-{given.attempt}"
        future = self._client.submit(analyse, given.files, key=name, pure=False)
        self._out[future] = given
        return future

    def _take_back(self, future: Future) -> _Given | None:
        """Keep a result, or return what must be handed out again: a worker died and its result with it."""
        given = self._out.pop(future)
        name, key = given.files.name, given.files.key
        try:
            outcome = future.result()
        except (asyncio.CancelledError, concurrent.futures.CancelledError):
            if self._client.status != "running":
                raise _lost() from None
            if given.attempt < _LOSSES:
                return dataclasses.replace(given, attempt=given.attempt + 1)
            message = f"its result was lost {_LOSSES} times with the worker that held it"
            outcome = nothing_read(name, key, message, status="failed")
        except Exception as error:  # noqa: BLE001 - workers died over it as often as dask tries, or the like
            outcome = nothing_read(name, key, f"{type(error).__name__}: {error}", status="failed")
        self._keep(name, key, outcome)
        return None

    def _keep(self, name: str, key: str, outcome: Outcome) -> None:
        self._folder.save(key, outcome)
        self._counts[outcome.status] += 1
        self._seconds += outcome.seconds
        if outcome.status in ("refused", "failed"):
            self._failures.append((name, outcome.message or ""))
        self._report()

    def _report(self) -> None:
        finished = self._skipped + sum(self._counts.values())
        self._tell(finished, len(self._studies), len(self._failures))


def _lost() -> RefusalError:
    return RefusalError(
        "the scheduler was lost.", hint="What is finished is kept; run the same command again for the rest."
    )
