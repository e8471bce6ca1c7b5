"""Objects through a pipe between processes of this package; arrays go as they are, without copies."""

from __future__ import annotations

import pickle
import struct
from typing import IO, Any

import numpy as np

__all__ = ["pack", "receive", "send", "write"]

_NUMBER = struct.Struct("<Q")


def send(pipe: IO[bytes], message: Any) -> None:
    """Write an object that `receive` can read.

    Parameters
    ----------
    pipe : binary stream
        Where to write.
    message : object
        What can be pickled. What cannot raises before anything is written.
    """
    write(pipe, pack(message))


def pack(message: Any) -> list[memoryview]:
    """Pickle an object, its arrays apart from the rest and not copied.

    Parameters
    ----------
    message : object
        What can be pickled.

    Returns
    -------
    list of memoryview
        For `write`.
    """
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(message, protocol=5, buffer_callback=buffers.append)
    return [memoryview(head), *(buffer.raw() for buffer in buffers)]


def write(pipe: IO[bytes], parts: list[memoryview]) -> None:
    """Write what `pack` returned.

    Parameters
    ----------
    pipe : binary stream
        Where to write.
    parts : list of memoryview
        The object.
    """
    pipe.write(_NUMBER.pack(len(parts)) + b"".join(_NUMBER.pack(part.nbytes) for part in parts))
    for part in parts:
        pipe.write(part)
    pipe.flush()


def receive(pipe: IO[bytes]) -> Any:
    """Read an object that `send` wrote.

    Parameters
    ----------
    pipe : binary stream
        Where to read; of a process one trusts, since unpickling runs what the message says.

    Returns
    -------
    object

    Raises
    ------
    EOFError
        Where the other side has closed the pipe.
    """
    (count,) = _NUMBER.unpack(_read(pipe, _NUMBER.size))
    sizes = [_NUMBER.unpack(_read(pipe, _NUMBER.size))[0] for _ in range(count)]
    head, *buffers = [_read(pipe, size) for size in sizes]
    return pickle.loads(head, buffers=buffers)  # noqa: S301 - our own process


def _read(pipe: IO[bytes], size: int) -> memoryview:
    # Not a bytearray, which would be filled with zeros first.
    whole = np.empty(size, np.uint8).data
    filled = 0
    while filled < size:
        read = pipe.readinto(whole[filled:])  # type: ignore[attr-defined]  # binary streams have it
        if not read:
            raise EOFError
        filled += read
    return whole
