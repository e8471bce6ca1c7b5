"""The key of a posterior: a digest of everything its numbers depend on."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import percept


def run_key(*asked: object) -> str:
    """Return the key of what a run is asked."""
    digest = hashlib.sha256(numbers_version().encode())
    _Walk(digest).add(asked)
    return digest.hexdigest()


@functools.cache
def numbers_version(*parts: str) -> str:
    """Return what else decides the digits of a result: versions, and a digest of the code itself.

    Parameters
    ----------
    *parts : str
        Packages of percept whose code counts; "inference" where none is named.

    Returns
    -------
    str
    """
    # emcee's version is read without importing it, which would cost what the cache saves.
    packages = {name: metadata.version(name) for name in ("numpy", "scipy", "emcee")}
    root = Path(percept.__file__).parent
    code = hashlib.sha256()
    for part in parts or ("inference",):
        for path in sorted((root / part).rglob("*.py")):
            code.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return f"percept {percept.__version__} {packages} code {code.hexdigest()}"


class _Walk:
    """Feeds the state of nested objects to a digest; an object seen before goes in as its number.

    Containers always go in by value: whether two equal ones are one object is the interpreter's affair.
    """

    def __init__(self, digest: Any) -> None:
        self._digest = digest
        self._seen: dict[int, int] = {}

    def add(self, value: object) -> None:
        """Add a value with its type, so that 1, 1.0, True and "1" differ."""
        if value is None or isinstance(value, (bool, int, float, str, np.generic)):
            self._put(type(value).__name__, repr(value).encode())
        elif isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                raise TypeError("an array of objects has no key.")
            self._put("array", f"{value.dtype.str}{value.shape}".encode())
            self._digest.update(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, (tuple, list)):
            self._add_parts(value, list(value))
        elif isinstance(value, Mapping):
            self._add_parts(value, [part for item in value.items() for part in item])
        elif isinstance(value, slice):
            self._add_parts(value, [value.start, value.stop, value.step])
        elif id(value) in self._seen:
            self._put("seen", str(self._seen[id(value)]).encode())
        else:
            self._seen[id(value)] = len(self._seen)
            self._add_object(value)

    def _add_object(self, value: object) -> None:
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            parts: list[object] = [getattr(value, field.name) for field in dataclasses.fields(value)]
        elif type(value).__module__.startswith("percept.") and hasattr(value, "__dict__"):
            parts = [part for item in sorted(vars(value).items()) for part in item]
        else:
            raise TypeError(f"{type(value).__name__} has no key.")
        self._add_parts(value, parts)

    def _add_parts(self, value: object, parts: list[object]) -> None:
        self._put(type(value).__qualname__, str(len(parts)).encode())
        for part in parts:
            self.add(part)

    def _put(self, kind: str, text: bytes) -> None:
        self._digest.update(f"{kind}:{len(text)}:".encode() + text)
