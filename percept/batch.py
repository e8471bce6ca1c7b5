"""Many studies on whatever workers there are: one set of rows each, resumable, a bad one never fatal."""

from __future__ import annotations

import dataclasses
import hashlib
import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from percept.cache import digest, numbers_version
from percept.errors import PerceptError, UsageError
from percept.files import exclusive, whole_file, write_whole
from percept.scene import Scene
from percept.sessions import read_sessions
from percept.sessions.files import expand, fitting, is_pattern, may_be_study
from percept.study import Study
from percept.workers import Mapper

__all__ = ["Summary", "run_batch", "sources"]

#: A scene of this name in a study's folder goes before the batch's own.
SCENE_NAME = "scene.toml"
#: All studies in one table, in the order they were asked for.
TABLE_NAME = "batch.parquet"
# Studies per row group of that table: some ten thousand rows.
_GROUP = 128
Status = Literal["done", "withheld", "refused", "failed"]
_TEXT, _REAL, _COUNT = pa.string(), pa.float64(), pa.int64()

#: Columns of every result: what became of the study, then its intervals in N/m and N·s/m, one row
#: each; a study without intervals has one row. A study is "done" or "refused" by the reader or the
#: analysis. It is "withheld" where the gate failed: classical rows only. "failed" is the machine's
#: or an unreadable file's fault, and a later run tries again.
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
class Job:
    """A study that was read: what a worker needs, wherever it runs."""

    name: str  # The path it was given by
    key: str  # Digest of files, scene and versions: equal keys give equal rows
    study: Study


@dataclasses.dataclass(frozen=True)
class StudySource:
    """Where a study lies: a session file, a folder of them, or a published summary."""

    path: str
    given: Scene  # The batch's, for a study without one of its own
    changes: Mapping[
        str, Any
    ]  # Keys of `[inference]` that go before any scene's, None to leave one alone

    @property
    def scene(self) -> Scene:
        """The study's own scene, or the batch's."""
        own = Path(self.path) / SCENE_NAME
        return (Scene.load(own) if own.is_file() else self.given).with_inference(**self.changes)

    def key(self) -> str:
        """Return the digest of everything that the study's rows depend on."""
        scene, files = self.scene.to_dict(), expand([self.path])[0]
        contents = [
            (str(name), hashlib.sha256(Path(name).read_bytes()).hexdigest()) for name in files
        ]
        version = numbers_version("inference", "sessions", "study", "batch")
        return digest(version, self.path, contents, scene)

    def read(self) -> Job:
        """Read the sessions."""
        scene = self.scene
        sessions = read_sessions(self.path, scene=scene)
        return Job(self.path, self.key(), Study(sessions, scene))


def sources(
    paths: Iterable[str], *, scene: Scene | None = None, changes: Mapping[str, Any] | None = None
) -> list[StudySource]:
    """Take each path, and each that a pattern fits, as a study; those named twice once."""
    named = list(dict.fromkeys(one for path in paths for one in _studies(path)))
    if not named:
        raise UsageError(
            "no study was given.", hint="Name session files or folders, one per study."
        )
    return [StudySource(path, scene or Scene(), changes or {}) for path in named]


def _studies(path: str) -> list[str]:
    """Return the tables and folders of tables that a pattern fits; anything else as it is."""
    if not is_pattern(path):
        return [path]
    found = [one for one in fitting(path) if may_be_study(one)]
    if not found:
        raise UsageError(
            "no table and no folder of tables fits the pattern.",
            value=path,
            hint="Each match is one study.",
        )
    return found


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of one study."""

    status: Status
    message: str | None  # Why, or the error of a study that misses its tolerance
    table: bytes  # Its rows as Parquet


def analyse(job: Job) -> Outcome:
    """Fit a study and encode its intervals: what a worker does."""
    study, message = job.study, None
    status: Status = "done"
    intervals, found = None, dict[str, float]()
    try:
        intervals, found["subjects"] = study.intervals, len(study.sessions.subjects)
        if study.fit is not None:
            gate = study.fit.run.gate
            found |= {"steps": study.fit.run.steps, "worst_error": gate.worst_error}
            found |= {"rhat": gate.rhat, "effective_draws": gate.effective_draws}
            status = "done" if gate.passed else "withheld"
            message = study.fit.withheld or gate.error_reached or None
    except PerceptError as error:
        status, message = "refused", str(error)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is this study's and goes into its row
        status, message = "failed", f"{type(error).__name__}: {error}"
    return encode(job.name, job.key, status, message, intervals, **found)


def encode(
    study: str,
    key: str,
    status: Status,
    message: str | None,
    intervals: pd.DataFrame | None = None,
    **found: float,
) -> Outcome:
    """Encode the rows of a study: one per interval, or one without any."""
    rows = pd.DataFrame(index=[0]) if intervals is None or intervals.empty else intervals
    rows = rows.assign(study=study, key=key, status=status, message=message, **found)
    rows = rows.reindex(columns=SCHEMA.names)
    table = pa.Table.from_pandas(rows, SCHEMA, preserve_index=False).replace_schema_metadata()
    target = io.BytesIO()
    pq.write_table(table, target, compression="zstd")
    return Outcome(status, message, target.getvalue())


class BatchFolder:
    """Results under DIR: ``studies/KEY.parquet`` and ``batch.parquet``; to be used inside `opened`.

    The first two digits of a key name a folder between, so that a million studies stay listable.
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

    def verdict(self, key: str) -> tuple[Status, str | None] | None:
        """Return the status of a finished study and why it is not "done"; None where it must be tried."""
        if not self._path(key).exists():
            return None
        kept = pq.ParquetFile(self._path(key)).read(columns=["status", "message"])
        status, message = kept["status"][0].as_py(), kept["message"][0].as_py()
        return None if status == "failed" else (status, message)

    def save(self, key: str, outcome: Outcome) -> None:
        """Write the rows of a study; it is finished unless it failed."""
        path = self._path(key)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, outcome.table)

    def combine(self, keys: Sequence[str]) -> Path:
        """Write the rows of saved studies into one table, in their order, a few in memory at a time."""
        target = self.out / TABLE_NAME
        with (
            whole_file(target) as aside,
            pq.ParquetWriter(aside, SCHEMA, compression="zstd") as writer,
        ):
            for start in range(0, len(keys), _GROUP):
                tables = [
                    pq.ParquetFile(self._path(key)).read() for key in keys[start : start + _GROUP]
                ]
                writer.write_table(pa.concat_tables(tables))
        return target

    def _path(self, key: str) -> Path:
        return self.out / "studies" / key[:2] / f"{key}.parquet"


@dataclasses.dataclass(frozen=True)
class Summary:
    """What a batch came to, this run and earlier ones together."""

    table: Path  # The rows of all studies
    studies: int  # How many were asked for
    skipped: int  # Of them, how many an earlier run had finished
    counts: dict[str, int]  # How many of the studies ended in each status
    failures: tuple[tuple[str, str], ...]  # Name and message of each study that is not "done"
    inaccurate: tuple[
        tuple[str, str], ...
    ]  # Of each that is done with an error above its tolerance


def run_batch(
    studies: Sequence[StudySource],
    out: str | Path,
    mapper: Mapper,
    *,
    progress: Callable[[int, int, int], None] | None = None,
) -> Summary:
    """Analyse the studies that a folder has no rows of; rows depend on the studies, not on the workers.

    `progress` is told how many studies are finished, of how many, and how many of them are not
    done.
    """
    counts: Counter[str] = Counter()
    keys: list[str] = []
    failures: list[tuple[str, str]] = []
    inaccurate: list[tuple[str, str]] = []
    skipped = 0
    with BatchFolder.opened(out) as folder:

        def count(name: str, status: Status, message: str | None) -> None:
            counts[status] += 1
            if status != "done" or message:
                (inaccurate if status == "done" else failures).append((name, message or ""))
            if progress:
                progress(counts.total(), len(studies), len(failures))

        def unfinished() -> Iterator[Job]:
            """Read one study after the other; those that cannot be read or are finished need no worker."""
            nonlocal skipped
            for source in studies:
                status: Status = "failed"  # a file that cannot be opened may be there next time
                keys.append(digest("unread", source.path))
                try:
                    keys[-1] = source.key()
                    if verdict := folder.verdict(keys[-1]):
                        skipped += 1
                        count(source.path, *verdict)
                        continue
                    status = "refused"
                    job = source.read()
                except (PerceptError, OSError) as error:
                    folder.save(keys[-1], encode(source.path, keys[-1], status, str(error)))
                    count(source.path, status, str(error))
                else:
                    yield job

        for job, outcome in mapper(analyse, unfinished()):
            if isinstance(outcome, Exception):
                outcome = encode(
                    job.name, job.key, "failed", f"{type(outcome).__name__}: {outcome}"
                )
            folder.save(job.key, outcome)
            count(job.name, outcome.status, outcome.message)
        table = folder.combine(keys)
    return Summary(table, len(studies), skipped, dict(counts), tuple(failures), tuple(inaccurate))
