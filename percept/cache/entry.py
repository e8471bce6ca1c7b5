"""A run as bytes and back."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
from typing import Any

import numpy as np

from percept.inference.sampling.estimands import Estimates
from percept.inference.sampling.records import Gate, Run, Settings

_MAGIC = b"percept run 2\n"
_DIGEST_SIZE = 32
_RECORDS: dict[str, type[Any]] = {
    record.__name__: record
    for record in (
        Run,
        Estimates,
        Gate,
        Settings,
    )
}


class DamagedEntry(ValueError):  # noqa: N818 - what is caught is damage, and nobody outside the cache sees it
    """Bytes that are not a whole entry."""


def encode(run: Run) -> bytes:
    """Turn a run into bytes: a checksum, the records as JSON, and the arrays they refer to."""
    arrays: list[np.ndarray[Any, Any]] = []
    head = json.dumps(_plain(run, arrays)).encode()
    body = io.BytesIO()
    body.write(len(head).to_bytes(8, "little") + head)
    for array in arrays:
        np.lib.format.write_array(body, array, allow_pickle=False)
    content = body.getbuffer()
    return _MAGIC + _checksum(content) + content


def decode(data: bytes) -> Run:
    """Turn bytes into the run they were made of."""
    start = len(_MAGIC) + _DIGEST_SIZE
    content = memoryview(data)[start:]
    if not data.startswith(_MAGIC) or data[len(_MAGIC) : start] != _checksum(content):
        raise DamagedEntry("its checksum does not fit")
    try:
        body = io.BytesIO(content)
        head = json.loads(body.read(int.from_bytes(body.read(8), "little")))
        run = _record(head, body)
    except (TypeError, ValueError, KeyError) as error:
        raise DamagedEntry(f"it does not hold a run: {error}") from error
    if not isinstance(run, Run):
        raise DamagedEntry("it does not hold a run")
    return run


def _checksum(content: bytes | memoryview) -> bytes:
    return hashlib.blake2b(content, digest_size=_DIGEST_SIZE).digest()


def _plain(value: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays)}
    if type(value).__name__ in _RECORDS:
        fields = {f.name: _plain(getattr(value, f.name), arrays) for f in dataclasses.fields(value)}
        return {"record": type(value).__name__, "fields": fields}
    if isinstance(value, tuple):
        return [_plain(part, arrays) for part in value]
    if isinstance(value, dict):
        return {"map": {name: _plain(part, arrays) for name, part in value.items()}}
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    raise TypeError(f"{type(value).__name__} cannot be stored.")


def _record(value: Any, body: io.BytesIO) -> Any:
    """Undo `_plain`; arrays stand in the order in which the records name them."""
    if isinstance(value, list):
        return tuple(_record(part, body) for part in value)
    if not isinstance(value, dict):
        return value
    if "map" in value:
        return {name: _record(part, body) for name, part in value["map"].items()}
    if "array" in value:
        return np.lib.format.read_array(body, allow_pickle=False)
    return _RECORDS[value["record"]](**{name: _record(v, body) for name, v in value["fields"].items()})
