"""Run a batch: read studies as workers are free for them, keep what comes back as it comes."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from percept.batch.folder import BatchFolder
from percept.batch.inputs import StudyFiles, StudySource
from percept.batch.rows import Outcome, Status
from percept.batch.work import analyse, nothing_read
from percept.errors import PerceptError
from percept.workers import Job, Mapper


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
        How many of the studies ended in each status, now or in an earlier run.
    failures : tuple of (str, str)
        Name and message of each study that was refused or whose Bayesian numbers the gate withheld, now or in
        an earlier run, or that failed.
    inaccurate : tuple of (str, str)
        Name and message of each study that is done with a Monte Carlo error above its tolerance.
    seconds : float
        Sum of the workers' times, now.
    """

    table: Path
    studies: int
    skipped: int
    counts: dict[str, int]
    failures: tuple[tuple[str, str], ...]
    inaccurate: tuple[tuple[str, str], ...]
    seconds: float


def run_batch(
    studies: Sequence[StudySource],
    out: str | Path,
    mapper: Mapper,
    *,
    progress: Callable[[int, int, int], None] | None = None,
) -> Summary:
    """Analyse studies; the rows depend on the studies, not on the workers.

    Parameters
    ----------
    studies : sequence of StudySource
        The studies, as `percept.batch.sources` gives them.
    out : str or Path
        Folder of the results. Studies it holds with the same content, scene and version are skipped.
    mapper : Mapper
        The workers; see `percept.workers.open_mapper`.
    progress : callable, optional
        Told how many studies are finished, of how many, and how many of them are not done.

    Returns
    -------
    Summary

    Raises
    ------
    UsageError
        Where `out` cannot be written or another batch is writing there.
    RefusalError
        Where the mapper has no workers any more; what is finished is kept.
    """
    with BatchFolder.opened(out) as folder:
        batch = _Batch(studies, folder, progress)
        batch.run(mapper)
        return batch.summary(folder.combine(batch.keys))


class _Batch:
    """The state of a run: what was asked for, and what came back."""

    def __init__(
        self,
        studies: Sequence[StudySource],
        folder: BatchFolder,
        progress: Callable[[int, int, int], None] | None,
    ) -> None:
        self._studies = studies
        self._folder = folder
        self._tell = progress or (lambda done, studies, failed: None)
        self._skipped = 0
        self._counts: Counter[str] = Counter()
        self._failures: list[tuple[str, str]] = []
        self._inaccurate: list[tuple[str, str]] = []
        self._seconds = 0.0
        self.keys: list[str] = []

    def run(self, mapper: Mapper) -> None:
        """Analyse every study that is not finished."""
        for answer in mapper.map(analyse, self._unfinished()):
            name, key, outcome = answer.job.argument.name, answer.job.key, answer.result
            if isinstance(outcome, Exception):
                message = f"{type(outcome).__name__}: {outcome}"
                outcome = nothing_read(name, key, message, status="failed")
            self._keep(name, key, outcome)

    def summary(self, table: Path) -> Summary:
        """Return what the run came to."""
        return Summary(
            table, len(self._studies), self._skipped, dict(self._counts),
            tuple(self._failures), tuple(self._inaccurate), self._seconds,
        )  # fmt: skip

    def _unfinished(self) -> Iterator[Job[StudyFiles]]:
        """Read one study after the other, those that cannot be read being done with at once."""
        for study in self._studies:
            try:
                files = study.read()
            except PerceptError as error:
                key = hashlib.sha256(f"unread {study.path}".encode()).hexdigest()
                self.keys.append(key)
                self._keep(study.path, key, nothing_read(study.path, key, str(error), status="failed"))
                continue
            key = files.key
            self.keys.append(key)
            if self._folder.finished(key):
                self._skipped += 1
                self._count(files.name, *self._folder.verdict(key))
            else:
                yield Job(key, files)

    def _keep(self, name: str, key: str, outcome: Outcome) -> None:
        self._folder.save(key, outcome)
        self._seconds += outcome.seconds
        self._count(name, outcome.status, outcome.message)

    def _count(self, name: str, status: Status, message: str | None) -> None:
        self._counts[status] += 1
        if status != "done":
            self._failures.append((name, message or ""))
        elif message:
            self._inaccurate.append((name, message))
        self._tell(sum(self._counts.values()), len(self._studies), len(self._failures))
