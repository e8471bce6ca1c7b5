"""Many studies on whatever workers there are: one set of rows each, resumable, a bad one never fatal."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Literal

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from percept.cache import digest, numbers_version
from percept.errors import PerceptError, RefusalError, UsageError
from percept.files import exclusive, remove_abandoned, whole_file, write_whole
from percept.scene import Scene
from percept.sessions import ReadOptions, read_sessions
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
class StudyFiles:
    """A study as bytes: what a worker needs, wherever it runs."""

    name: str  # The path it was given by
    root: str  # What stands before the relative paths where the files were read
    files: tuple[tuple[str, bytes], ...]  # Relative path and content of every file
    scene: dict[str, Any]  # Tables of the scene
    key: str  # Digest of all of it and of versions: equal keys give equal rows


@dataclasses.dataclass(frozen=True)
class StudySource:
    """Where a study lies: a session file, a folder of them, or a published summary."""

    path: str
    scene: Scene  # The batch's, for a study without one of its own
    changes: Mapping[str, Any]  # Keys of `[inference]` that go before any scene's, None to leave one alone

    def read(self) -> StudyFiles:
        """Read its files."""
        own = Path(self.path) / SCENE_NAME
        scene = Scene.load(own) if own.is_file() else self.scene
        names = expand([self.path]).files
        folder = os.path.commonpath([Path(name).parent for name in names])
        root = f"{folder}/" if folder else ""
        try:
            files = tuple(
                (Path(name).relative_to(folder).as_posix(), Path(name).read_bytes()) for name in names
            )
        except OSError as error:
            raise UsageError(f"cannot be read: {error.strerror}.", file=str(error.filename)) from error
        tables = scene.with_inference(**self.changes).to_dict()
        version = numbers_version("inference", "sessions", "study", "batch")
        contents = [(name, hashlib.sha256(data).hexdigest()) for name, data in files]
        key = digest(version, self.path, root, contents, tables)
        return StudyFiles(self.path, root, files, tables, key)


def sources(
    paths: Iterable[str], *, scene: Scene | None = None, changes: Mapping[str, Any] | None = None
) -> list[StudySource]:
    """Take each path, and each that a pattern fits, as a study; those named twice once."""
    named = list(dict.fromkeys(one for path in paths for one in _studies(path)))
    if not named:
        raise UsageError("no study was given.", hint="Name session files or folders, one per study.")
    if "-" in named:
        raise UsageError("a batch does not read standard input.", value="-", hint="Name files or folders.")
    return [StudySource(path, scene or Scene(), changes or {}) for path in named]


def _studies(path: str) -> list[str]:
    """Return the tables and folders of tables that a pattern fits; anything else as it is."""
    if not is_pattern(path):
        return [path]
    found = [one for one in fitting(path) if may_be_study(one)]
    if not found:
        raise UsageError(
            "no table and no folder of tables fits the pattern.", value=path, hint="Each match is one study."
        )
    return found


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of one study."""

    status: Status
    message: str | None  # Why, or the error of a study that misses its tolerance
    table: bytes  # Its rows as Parquet
    seconds: float = 0.0  # Time the analysis took


def analyse(files: StudyFiles) -> Outcome:
    """Fit a study and encode its intervals: what a worker does."""
    started = time.perf_counter()
    status: Status = "done"
    message: str | None = None
    intervals, found = None, dict[str, Any]()
    try:
        study = _study(files)
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
    outcome = encode(files.name, files.key, status, message, intervals, **found)
    return dataclasses.replace(outcome, seconds=time.perf_counter() - started)


def _study(files: StudyFiles) -> Study:
    """Read the files from a folder that is gone afterwards; messages name the paths the user gave."""
    scene = Scene.from_tables(files.scene)
    options = ReadOptions.from_mapping(dict(scene))
    with tempfile.TemporaryDirectory(prefix="percept-") as root:
        folder = Path(root) / "study"
        for name, data in files.files:
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        try:
            study = Study(read_sessions(*(folder / name for name, _ in files.files), options=options), scene)
            # Here, where a message can still say the user's path for the folder's.
            _ = study.intervals
        except PerceptError as error:
            raise RefusalError(str(error).replace(f"{folder}/", files.root)) from error
    return study


def encode(
    study: str,
    key: str,
    status: Status,
    message: str | None,
    intervals: pd.DataFrame | None = None,
    **found: object,
) -> Outcome:
    """Encode the rows of a study: one per interval, or one without any."""
    shared = {"study": study, "key": key, "status": status, "message": message, **found}
    rows: list[dict[Any, Any]] = (
        [{}] if intervals is None or intervals.empty else intervals.to_dict("records")
    )
    columns = {
        field.name: pa.array(
            [{**row, **shared}.get(field.name) for row in rows], field.type, from_pandas=True
        )
        for field in SCHEMA
    }
    target = io.BytesIO()
    pq.write_table(pa.table(columns, schema=SCHEMA), target, compression="zstd")
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
        """Hold DIR, made where it does not exist, against other batches; remove what killed ones left."""
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
                    for inside in (folder.out, *folder.out.glob("studies/*")):
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
        with self._writing():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, outcome.table)

    def combine(self, keys: Sequence[str]) -> Path:
        """Write the rows of saved studies into one table, in their order, a few in memory at a time."""
        target = self.out / TABLE_NAME
        with (
            self._writing(),
            whole_file(target) as aside,
            pq.ParquetWriter(aside, SCHEMA, compression="zstd") as writer,
        ):
            for start in range(0, len(keys), _GROUP):
                tables = [pq.ParquetFile(self._path(key)).read() for key in keys[start : start + _GROUP]]
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
    inaccurate: tuple[tuple[str, str], ...]  # Of each that is done with an error above its tolerance
    seconds: float  # Sum of the workers' times in this run


def run_batch(
    studies: Sequence[StudySource],
    out: str | Path,
    mapper: Mapper,
    *,
    progress: Callable[[int, int, int], None] | None = None,
) -> Summary:
    """Analyse the studies that a folder has no rows of; rows depend on the studies, not on the workers.

    `progress` is told how many studies are finished, of how many, and how many of them are not done.
    """
    counts: Counter[str] = Counter()
    keys: list[str] = []
    failures: list[tuple[str, str]] = []
    inaccurate: list[tuple[str, str]] = []
    skipped, seconds = 0, 0.0
    with BatchFolder.opened(out) as folder:

        def count(name: str, status: Status, message: str | None) -> None:
            counts[status] += 1
            if status != "done" or message:
                (inaccurate if status == "done" else failures).append((name, message or ""))
            if progress:
                progress(counts.total(), len(studies), len(failures))

        def unfinished() -> Iterator[StudyFiles]:
            """Read one study after the other; those that cannot be read or are finished need no worker."""
            nonlocal skipped
            for study in studies:
                try:
                    files = study.read()
                except PerceptError as error:
                    keys.append(digest("unread", study.path))
                    folder.save(keys[-1], encode(study.path, keys[-1], "failed", str(error)))
                    count(study.path, "failed", str(error))
                    continue
                keys.append(files.key)
                if verdict := folder.verdict(files.key):
                    skipped += 1
                    count(files.name, *verdict)
                else:
                    yield files

        for files, outcome in mapper(analyse, unfinished()):
            if isinstance(outcome, Exception):
                message = f"{type(outcome).__name__}: {outcome}"
                outcome = encode(files.name, files.key, "failed", message)
            folder.save(files.key, outcome)
            seconds += outcome.seconds
            count(files.name, outcome.status, outcome.message)
        table = folder.combine(keys)
    return Summary(table, len(studies), skipped, dict(counts), tuple(failures), tuple(inaccurate), seconds)
