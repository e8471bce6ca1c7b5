"""Posteriors that were sampled before, found by what they depend on."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
import json
import logging
import os
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

import percept
from percept.errors import UsageError
from percept.files import exclusive, write_whole
from percept.inference.sampling.gate import Gate, Measured, Run, Settings

_SUFFIX = ".npz"
_ARRAYS = ("points", "components")
_MEASURED = ("value", "scale", "errors", "times", "rhats")
# Bytes of all entries: some hundred posteriors of ordinary studies.
_LIMIT = 1_000_000_000
#: Packages that decide the digits of a run, and whether the gate passes it.
_DECISIVE = ("numpy", "scipy", "emcee")
_log = logging.getLogger("percept.cache")


def cache_folder() -> Path | None:
    """Return PERCEPT_CACHE, None where it is "off", else ``percept`` in the user's cache folder."""
    named = os.environ.get("PERCEPT_CACHE")
    if named == "off":
        return None
    if named:
        return Path(named).expanduser()
    return platformdirs.user_cache_path("percept", appauthor=False)


@functools.cache
def numbers_version(*parts: str) -> str:
    """Return what else decides the digits of a result: versions, and a digest of percept's code.

    Parameters
    ----------
    *parts : str
        Folders and modules of percept, such as ``"inference"``; ``"."`` is all of it.

    Returns
    -------
    str
    """
    # Versions are read without importing what they are of, which would cost what the cache saves.
    packages = {name: metadata.version(name) for name in _DECISIVE}
    root = Path(percept.__file__).parent
    code = hashlib.sha256()
    for part in parts:
        for path in sorted((root / part).rglob("*.py")) or [root / f"{part}.py"]:
            name = path.relative_to(root).as_posix().encode()
            code.update(name + b"\0" + path.read_bytes() + b"\0")
    return f"percept {percept.__version__} {packages} code {code.hexdigest()}"


def digest(*parts: object) -> str:
    """Return the SHA-256 of nested lists and dicts of text, numbers, None, arrays and scenes.

    Parameters
    ----------
    *parts : object
        What to digest; the order of a dict's keys does not count.

    Returns
    -------
    str
        In hexadecimal.

    Raises
    ------
    TypeError
        A part of another type.
    """
    return hashlib.sha256(json.dumps(parts, default=_plain, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> object:
    """Stand for an array or a scene in JSON."""
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if not isinstance(value, np.ndarray) or value.dtype.hasobject:
        raise TypeError(f"{type(value).__name__} has no digest.")
    data = np.ascontiguousarray(value).tobytes()
    return [value.dtype.str, value.shape, hashlib.sha256(data).hexdigest()]


def encode(run: Run, question: str) -> bytes:
    """Turn a run into an npz archive: its arrays, and the question and the rest as JSON."""
    rest = {
        "question": question,
        "names": run.estimates.names,
        "gate": dataclasses.asdict(run.gate),
        "steps": run.steps,
        "stride": run.stride,
        "settings": dataclasses.asdict(run.settings),
    }
    arrays = {name: getattr(run, name) for name in _ARRAYS}
    arrays |= {name: getattr(run.estimates, name) for name in _MEASURED}
    archive = io.BytesIO()
    np.savez(archive, rest=np.frombuffer(json.dumps(rest).encode(), dtype=np.uint8), **arrays)
    return archive.getvalue()


def decode(data: bytes, question: str) -> Run:
    """Turn an archive into the run it was made of; damage raises whatever numpy's reader meets."""
    with np.load(io.BytesIO(data), allow_pickle=False) as kept:
        rest = json.loads(kept["rest"].tobytes())
        if rest["question"] != question:
            raise ValueError("it answers another question")
        gate = Gate(**{**rest["gate"], "reasons": tuple(rest["gate"]["reasons"])})
        return Run(
            **{name: kept[name] for name in _ARRAYS},
            estimates=Measured(tuple(rest["names"]), *(kept[name] for name in _MEASURED)),
            gate=gate,
            steps=rest["steps"],
            stride=rest["stride"],
            settings=Settings(**rest["settings"]),
        )


class PosteriorCache:
    """Runs that were finished before, by what they were asked; safe to share between processes.

    An entry is written whole or not at all, and is replaced with a message when it is damaged.
    Nothing here can fail an analysis: what cannot be read is computed, what cannot be written is
    said and left. Beyond `limit` bytes the entries not used for longest go.

    Parameters
    ----------
    folder : Path
        The entries' own, made where it does not exist.
    limit : int
        Bytes that all entries together may take.
    """

    def __init__(self, folder: Path, *, limit: int = _LIMIT) -> None:
        self.folder = folder
        self.limit = limit

    def find(self, asked: tuple[object, ...]) -> Run | None:
        """Return the stored run of what is asked, equal in every digit."""
        path = self._path(asked)
        try:
            run = decode(path.read_bytes(), path.stem)
        except FileNotFoundError:
            return None
        except Exception as damage:  # noqa: BLE001 - bytes at will can raise anything in zip, npy and JSON
            _log.warning("A stored posterior cannot be read (%s): it is computed again.", damage)
            return None
        # Gone by another process, or not ours to touch: its turn to go comes sooner.
        with suppress(OSError):
            os.utime(path)
        _log.info("posterior %s found in %s", path.stem[:12], self.folder)
        return run

    def keep(self, asked: tuple[object, ...], run: Run) -> None:
        """Store the run of what is asked."""
        path = self._path(asked)
        data = encode(run, path.stem)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with exclusive(self.folder):
                write_whole(path, data)
                self._evict()
        except (OSError, UsageError) as error:
            _log.warning("The posterior was not kept for next time in %s: %s", self.folder, error)

    def entries(self) -> dict[Path, int]:
        """Return the files and their sizes in bytes, the longest unused first."""
        states = {}
        for path in self.folder.glob(f"[!.]*{_SUFFIX}"):
            with suppress(FileNotFoundError):
                states[path] = path.stat()
        oldest_first = sorted(states, key=lambda path: states[path].st_mtime_ns)
        return {path: states[path].st_size for path in oldest_first}

    def clear(self) -> int:
        """Remove every entry; return how many went."""
        if not self.folder.is_dir():
            return 0
        with exclusive(self.folder):
            entries = self.entries()
            for path in entries:
                path.unlink(missing_ok=True)
        return len(entries)

    def _path(self, asked: tuple[object, ...]) -> Path:
        return self.folder / f"{digest(numbers_version('inference', 'cache'), *asked)}{_SUFFIX}"

    def _evict(self) -> None:
        """Remove what is unused for longest, until the rest fits."""
        entries = self.entries()
        total = sum(entries.values())
        for path, size in entries.items():
            if total > self.limit:
                path.unlink(missing_ok=True)
                total -= size
