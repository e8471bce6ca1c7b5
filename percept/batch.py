"""Many studies on any workers: one set of rows each; resumable, a bad one never fatal."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from percept.batch_folder import BatchFolder, Outcome, Status, TableFormat, encode, failed
from percept.cache import digest, numbers_version
from percept.errors import PerceptError, UsageError
from percept.scene import Scene
from percept.sessions import read_sessions
from percept.sessions.paths import expand, fitting, is_pattern, may_be_study
from percept.study import Study
from percept.workers import Mapper

__all__ = ["Job", "StudySource", "Summary", "analyse", "run_batch", "sources"]

# A scene of this name in a study's folder goes before the batch's own.
_SCENE_NAME = "scene.toml"
# Parts of percept whose code decides the digits of a study's rows.
_PARTS = ("inference", "sessions", "study", "batch", "batch_folder")


@dataclass(frozen=True)
class Job:
    """A study that was read: what a worker needs, wherever it runs."""

    name: str  # The path it was given by
    key: str  # Digest of files, scene and versions: equal keys give equal rows
    study: Study


@dataclass(frozen=True)
class StudySource:
    """Where a study lies: a session file, a folder of them, or a published summary."""

    path: str
    batch_scene: Scene  # For a study without one of its own
    changes: Mapping[
        str, Any
    ]  # Keys of `[inference]` that go before any scene's; None changes none

    @property
    def scene(self) -> Scene:
        """The study's own scene, or the batch's."""
        own = Path(self.path) / _SCENE_NAME
        scene = Scene.load(own) if own.is_file() else self.batch_scene
        return scene.with_inference(**self.changes)

    def key(self) -> str:
        """Return the digest of everything that the study's rows depend on."""
        scene = self.scene.to_dict()
        contents = []
        for file in expand([self.path])[0]:
            sha256 = hashlib.sha256(Path(file).read_bytes()).hexdigest()
            contents.append((str(file), sha256))
        return digest(numbers_version(*_PARTS), self.path, contents, scene)

    def read(self) -> Job:
        """Read the sessions."""
        scene = self.scene
        sessions = read_sessions(self.path, scene=scene)
        return Job(self.path, self.key(), Study(sessions, scene))


def sources(
    paths: Iterable[str], *, scene: Scene | None = None, changes: Mapping[str, Any] | None = None
) -> list[StudySource]:
    """Take each path, and each that a pattern fits, as a study; those named twice once.

    Parameters
    ----------
    paths : iterable of str
        Session files, folders of them, or patterns such as ``"lab*/*.csv"``.
    scene : Scene, optional
        Scene of the studies that have no ``scene.toml`` of their own.
    changes : mapping, optional
        Keys of ``[inference]`` that go before any scene's. None changes none.

    Returns
    -------
    list of StudySource

    Raises
    ------
    UsageError
        There is no path, or nothing fits a pattern.
    """
    studies = dict.fromkeys(study for path in paths for study in _studies(path))
    if not studies:
        raise UsageError(
            "no study was given.", hint="Name session files or folders, one per study."
        )
    return [StudySource(path, scene or Scene(), changes or {}) for path in studies]


def _studies(path: str) -> list[str]:
    """Return the tables and folders of tables that a pattern fits; anything else as it is."""
    if not is_pattern(path):
        return [path]
    studies = [match for match in fitting(path) if may_be_study(match)]
    if not studies:
        raise UsageError(
            "no table and no folder of tables fits the pattern.",
            value=path,
            hint="Each match is one study.",
        )
    return studies


def analyse(job: Job) -> Outcome:
    """Fit a study and encode its intervals: what a worker does."""
    study = job.study
    try:
        intervals = study.intervals
        fit = study.parts.fit
    except PerceptError as error:
        return encode(job.name, job.key, "refused", str(error))
    except Exception as error:  # noqa: BLE001 - it is this study's, and goes into its row
        return failed(job.name, job.key, error)
    rows = intervals.assign(subjects=len(study.sessions.subjects))
    if fit is None:
        return encode(job.name, job.key, "done", "", rows)
    gate = fit.run.gate
    rows = rows.assign(
        steps=fit.run.steps,
        worst_error=gate.worst_error,
        rhat=gate.rhat,
        effective_draws=gate.effective_draws,
    )
    message = fit.withheld or gate.error_reached
    return encode(job.name, job.key, "done" if gate.passed else "withheld", message, rows)


@dataclass
class Summary:
    """What a batch came to, this run and earlier ones together."""

    studies: int  # How many were asked for
    skipped: int = 0  # Of them, how many an earlier run had finished
    counts: Counter[str] = field(default_factory=Counter)  # How many ended in each status
    # Name and message of each study that is not "done", and of each that is done with an error
    # above its tolerance.
    failures: list[tuple[str, str]] = field(default_factory=list)
    inaccurate: list[tuple[str, str]] = field(default_factory=list)
    table: Path = Path()  # The rows of all studies

    def count(self, name: str, status: Status, message: str) -> None:
        """Count a finished study."""
        self.counts[status] += 1
        if status != "done":
            self.failures.append((name, message))
        elif message:
            self.inaccurate.append((name, message))


def run_batch(
    studies: Sequence[StudySource],
    out: str | Path,
    mapper: Mapper,
    *,
    table_format: TableFormat = "csv",
    progress: Callable[[Summary], None] | None = None,
    force: bool = False,
) -> Summary:
    """Analyse the studies that a folder has no rows of.

    Rows depend on the studies, not on the workers.

    Parameters
    ----------
    studies : sequence of StudySource
        The studies, as `sources` gives them.
    out : str or Path
        Folder of the results, made where it does not exist.
    mapper : Mapper
        The workers.
    table_format : {"csv", "parquet"}
        Of the table of all studies. Parquet needs the extra ``tables``.
    progress : callable, optional
        Told what the batch has come to, after every study.
    force : bool
        Write also into a folder with files that percept did not write.

    Returns
    -------
    Summary

    Raises
    ------
    UsageError
        The folder cannot be used, holds files that percept did not write, or Parquet is asked for
        and pyarrow is not installed.
    """
    if table_format == "parquet":
        _require_pyarrow()
    summary = Summary(len(studies))
    with BatchFolder.opened(out, force=force) as folder:
        batch = _Batch(studies, folder, summary, progress)
        for job, outcome in mapper(analyse, batch.unfinished()):
            if isinstance(outcome, Exception):
                outcome = failed(job.name, job.key, outcome)
            folder.save(job.key, outcome)
            batch.count(job.name, outcome.status, outcome.message)
        summary.table = folder.combine(batch.keys, table_format)
    return summary


@dataclass
class _Batch:
    """A batch while it runs."""

    studies: Sequence[StudySource]
    folder: BatchFolder
    summary: Summary
    progress: Callable[[Summary], None] | None
    keys: list[str] = field(default_factory=list)  # Of the studies, in their order

    def unfinished(self) -> Iterator[Job]:
        """Read one study after the other; unreadable and finished ones need no worker."""
        for source in self.studies:
            try:
                key = source.key()
            except (PerceptError, OSError) as error:
                # A file that cannot be opened may be there next time.
                self._refuse(source, digest("unread", source.path), "failed", error)
                continue
            if self._is_finished(source, key):
                self.keys.append(key)
                continue
            try:
                job = source.read()
            except (PerceptError, OSError) as error:
                self._refuse(source, key, "refused", error)
                continue
            self.keys.append(key)
            yield job

    def count(self, name: str, status: Status, message: str) -> None:
        """Count a study and tell how far the batch is."""
        self.summary.count(name, status, message)
        if self.progress:
            self.progress(self.summary)

    def _is_finished(self, source: StudySource, key: str) -> bool:
        """Whether an earlier run has finished a study; count it."""
        kept = self.folder.kept(key)
        if kept is None or kept.status == "failed":
            return False
        self.summary.skipped += 1
        self.count(source.path, kept.status, kept.message)
        return True

    def _refuse(self, source: StudySource, key: str, status: Status, error: Exception) -> None:
        """Keep the row of a study that no worker gets."""
        self.keys.append(key)
        self.folder.save(key, encode(source.path, key, status, str(error)))
        self.count(source.path, status, str(error))


def _require_pyarrow() -> None:
    try:
        import pyarrow.parquet  # noqa: F401 - whether it is there
    except ImportError:
        raise UsageError(
            "a Parquet table needs pyarrow, which is not installed.",
            key="--format",
            value="parquet",
            hint="Install the extra, percept-haptics[tables], or leave --format out.",
        ) from None
