"""Many studies on any workers: one set of rows each; resumable, a bad one never fatal."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from percept.cache import digest, numbers_version
from percept.checkpoint import Checkpoint
from percept.errors import PerceptError, UsageError
from percept.files import exclusive, inert, own_folder, write_whole
from percept.scene import Scene
from percept.sessions import read_sessions
from percept.sessions.inputs import expand
from percept.study import Study
from percept.workers import Mapper

# A scene of this name in a study's folder goes before the batch's own.
_SCENE_NAME = "scene.toml"
# Parts of percept whose code decides the digits of a study's rows.
_PARTS = ("inference", "sessions", "study", "batch")
# What an earlier run finished, in the folder of the results.
_FINISHED = "finished.jsonl"

#: A study is "done", or "refused" by the reader or the analysis. Where the gate failed it is
#: "withheld" and has classical rows only. "failed" is the fault of the machine or of an unreadable
#: file, and a later run tries again.
Status = Literal["done", "withheld", "refused", "failed"]

#: Columns of every result: what became of the study, then its intervals in the unit of their
#: quantity, one row each. A study without intervals has one row.
COLUMNS = (
    "study",
    "key",
    "status",
    "message",
    "subjects",
    "steps",
    "worst_error",
    "rhat",
    "effective_draws",
    "environment",
    "parameter",
    "kind",
    "method",
    "family",
    "joint",
    "level",
    "share",
    "confidence",
    "lower",
    "upper",
    "estimate",
    "n",
    "unit",
    "reference",
)
_HEADER = ",".join(COLUMNS) + "\n"
_COUNTS = dict.fromkeys(("subjects", "steps", "n"), "Int64")


@dataclass(frozen=True)
class Outcome:
    """What became of one study."""

    status: Status
    message: str  # Why, or the error of a study that misses its tolerance; empty where all is well
    rows: str  # As CSV without a header: every number reads back as the same double


def encode(
    study: str, key: str, status: Status, message: str, rows: pd.DataFrame | None = None
) -> Outcome:
    """Encode the rows of a study: one per interval, or one without any."""
    if rows is None or rows.empty:
        rows = pd.DataFrame(index=[0])
    rows = rows.assign(study=study, key=key, status=status, message=message)
    rows = rows.reindex(columns=list(COLUMNS)).astype(_COUNTS)
    for name in rows:
        if not pd.api.types.is_numeric_dtype(rows[name]):
            rows[name] = rows[name].map(inert, na_action="ignore")
    return Outcome(status, message, rows.to_csv(index=False, header=False, lineterminator="\n"))


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
    """Take each path as a study; those named twice once.

    Parameters
    ----------
    paths : iterable of str
        Session files, or folders of them.
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
        There is no path, or one is a pattern: its files would be read as one study.
    """
    studies = dict.fromkeys(paths)
    hint = "Name session files or folders, one per study."
    if not studies:
        raise UsageError("no study was given.", hint=hint)
    for path in studies:
        if "*" in path and not Path(path).exists():
            raise UsageError("a batch takes paths, not patterns.", value=path, hint=hint)
    return [StudySource(path, scene or Scene(), changes or {}) for path in studies]


def analyse(job: Job) -> Outcome:
    """Fit a study and encode its intervals: what a worker does."""
    study = job.study
    try:
        intervals = study.intervals
        fit = study.fit
    except PerceptError as error:
        return encode(job.name, job.key, "refused", str(error))
    rows = intervals.drop(columns="covers").assign(subjects=len(study.sessions.subjects))
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

    def count(self, name: str, outcome: Outcome) -> None:
        """Count a study."""
        self.counts[outcome.status] += 1
        if outcome.status != "done":
            self.failures.append((name, outcome.message))
        elif outcome.message:
            self.inaccurate.append((name, outcome.message))


def run_batch(
    studies: Sequence[StudySource],
    out: str | Path,
    mapper: Mapper,
    *,
    progress: Callable[[Summary], None] = lambda summary: None,
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
        The folder cannot be used, or holds files that percept did not write.
    """
    folder = own_folder(out, force=force)
    summary = Summary(len(studies), table=folder / "batch.csv")
    keys: list[str] = []  # Of the studies, in their order
    with exclusive(folder, wait=False):
        kept = Checkpoint(folder / _FINISHED, "batch", what="analysed")
        outcomes = {key: Outcome(**line) for key, line in kept.read().items()}

        def tell(name: str, outcome: Outcome) -> None:
            summary.count(name, outcome)
            progress(summary)

        def finish(name: str, key: str, outcome: Outcome) -> None:
            """Keep what became of a study."""
            outcomes[key] = outcome
            kept.append(key, dataclasses.asdict(outcome))
            tell(name, outcome)

        def unfinished() -> Iterator[Job]:
            """Read one study after the other; unreadable and finished ones need no worker."""
            for source in studies:
                name = source.path
                try:
                    key = source.key()
                except (PerceptError, OSError) as error:
                    # A file that cannot be opened may be there next time.
                    key = digest("unread", name)
                    keys.append(key)
                    finish(name, key, encode(name, key, "failed", str(error)))
                    continue
                keys.append(key)
                earlier = outcomes.get(key)
                if earlier is not None and earlier.status != "failed":
                    summary.skipped += 1
                    tell(name, earlier)
                    continue
                try:
                    yield source.read()
                except (PerceptError, OSError) as error:
                    finish(name, key, encode(name, key, "refused", str(error)))

        for job, outcome in mapper(analyse, unfinished()):
            if isinstance(outcome, Exception):
                # It is not about the data.
                why = f"{type(outcome).__name__}: {outcome}"
                outcome = encode(job.name, job.key, "failed", why)
            finish(job.name, job.key, outcome)
        rows = _HEADER + "".join(outcomes[key].rows for key in keys)
        write_whole(summary.table, rows.encode())
    return summary
