"""Files that are whole or not there, and folders that one run has to itself."""

from __future__ import annotations

import errno
import os
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_SUFFIX = ".part"
# What a file system says that has no locks; those of NFS before version 4 among them.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a hidden name beside `path` to write to; at the end that file takes the place of `path`.

    `path` is never seen in part, whatever stops the process or the machine: the bytes go to the disk first.
    """
    path = path.resolve()
    aside = path.with_name(f".{path.name}-{secrets.token_hex(8)}{_SUFFIX}")
    aside.touch(exist_ok=False)  # with the permissions any new file has, which `tempfile` would not give
    try:
        yield aside
        _sync(aside, os.O_RDWR)
        aside.replace(path)
    except BaseException:
        with suppress(OSError):
            aside.unlink()
        raise
    _sync_folder(path.parent)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file by `whole_file`."""
    with whole_file(path) as aside:
        aside.write_bytes(data)


def remove_abandoned(folder: Path) -> None:
    """Remove what `whole_file` left in a folder when its process was killed.

    To be called by the one who holds the folder by `exclusive`: nobody is writing then.
    """
    for path in folder.glob(f".*-*{_SUFFIX}"):
        with suppress(OSError):
            path.unlink()


@contextmanager
def exclusive(folder: Path, *, wait: bool = True) -> Iterator[bool]:
    """Hold a folder alone, among those who ask by this function or `shared`.

    The lock is the operating system's, on the folder itself: it ends with the process however that ends, and
    neither a process number nor a clock is trusted.
    """
    with _locked(folder, alone=True, wait=wait) as held:
        yield held


@contextmanager
def shared(folder: Path) -> Iterator[bool]:
    """Hold a folder together with others; `exclusive` waits, or fails, as long as it lasts."""
    with _locked(folder, alone=False, wait=True) as held:
        yield held


def _sync(path: Path, mode: int) -> None:
    handle = os.open(path, mode)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


if sys.platform == "win32":

    @contextmanager
    def _locked(folder: Path, *, alone: bool, wait: bool) -> Iterator[bool]:
        yield False

    def _sync_folder(folder: Path) -> None:
        """Do nothing: a folder cannot be opened here."""

else:
    import fcntl

    @contextmanager
    def _locked(folder: Path, *, alone: bool, wait: bool) -> Iterator[bool]:
        handle = os.open(folder, os.O_RDONLY)
        try:
            how = fcntl.LOCK_EX if alone else fcntl.LOCK_SH
            try:
                fcntl.flock(handle, how if wait else how | fcntl.LOCK_NB)
                held = True
            except BlockingIOError:
                raise
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
                held = False
            yield held
        finally:
            os.close(handle)

    def _sync_folder(folder: Path) -> None:
        with suppress(OSError):  # some network file systems refuse it
            _sync(folder, os.O_RDONLY)
