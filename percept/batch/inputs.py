"""Studies of a batch: where each lies, and its files as bytes that any worker can analyse."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from percept.cache import numbers_version
from percept.errors import UsageError
from percept.scene import Scene
from percept.sessions.sources import expand, fitting, is_pattern, may_be_study

#: A scene of this name in a study's folder goes before the batch's own.
SCENE_NAME = "scene.toml"


def batch_version() -> str:
    """Return versions and code that a study's rows depend on."""
    return numbers_version("inference", "sessions", "study", "batch")


@dataclasses.dataclass(frozen=True)
class StudyFiles:
    """A study as bytes: what a worker needs, wherever it runs."""

    name: str  # The path it was given by
    root: str  # What stands before the relative paths where the files were read
    files: tuple[tuple[str, bytes], ...]  # Relative path and content of every file
    scene: dict[str, Any]  # Tables of the scene
    version: str  # `batch_version` of the machine that asks

    @property
    def key(self) -> str:
        """Digest of all of it, 64 hexadecimal digits: equal keys give equal rows."""
        digest = hashlib.sha256()
        for part in (self.version, self.name, self.root, json.dumps(self.scene, sort_keys=True)):
            digest.update(hashlib.sha256(part.encode()).digest())
        for name, data in self.files:
            digest.update(hashlib.sha256(name.encode()).digest() + hashlib.sha256(data).digest())
        return digest.hexdigest()

    @property
    def size(self) -> int:
        """Bytes of its files."""
        return sum(len(data) for _, data in self.files)


@dataclasses.dataclass(frozen=True)
class StudySource:
    """Where a study lies.

    Attributes
    ----------
    path : str
        A session file, a folder of them, or a published summary.
    scene : Scene
        The batch's scene.
    changes : mapping
        Keys of `[inference]` that go before any scene's, None to leave one alone.
    """

    path: str
    scene: Scene
    changes: Mapping[str, Any]

    def read(self) -> StudyFiles:
        """Read its files.

        Returns
        -------
        StudyFiles

        Raises
        ------
        UsageError
            Nothing to read there, or a scene of its own that is wrong.
        """
        folder = Path(self.path)
        own = folder / SCENE_NAME
        scene = Scene.load(own) if own.is_file() else self.scene
        names = expand([self.path]).files
        root = os.path.commonpath([Path(name).parent for name in names])
        try:
            files = tuple(
                (Path(name).relative_to(root).as_posix(), Path(name).read_bytes()) for name in names
            )
        except OSError as error:
            raise UsageError(f"cannot be read: {error.strerror}.", file=str(error.filename)) from error
        tables = scene.with_inference(**self.changes).to_dict()
        return StudyFiles(self.path, f"{root}/" if root else "", files, tables, batch_version())


def sources(
    paths: Iterable[str], *, scene: Scene | None = None, changes: Mapping[str, Any] | None = None
) -> list[StudySource]:
    """Take each path, and each that a pattern fits, as a study; those named twice once.

    Parameters
    ----------
    paths : iterable of str
        Files, folders or patterns; "-" is refused.
    scene : Scene, optional
        For every study without one of its own.
    changes : mapping, optional
        Keys of `[inference]` that go before any scene's.

    Returns
    -------
    list of StudySource

    Raises
    ------
    UsageError
        Without a path, for standard input, or for a pattern that nothing fits.
    """
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
