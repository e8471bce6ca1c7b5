"""Files that are whole or not there, folders that one run holds, and folders of results moved into place."""

from __future__ import annotations

import errno
import hashlib
import os
import secrets
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from percept.errors import UsageError

_ASIDE = ".percept-unfinished-"
# No run holds files aside for longer: what is older was left by one that was killed.
_ABANDONED_AFTER = 86_400.0  # s
# Errors of a file system without locks, such as NFS before version 4.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a hidden name beside `path` to write to; at the end that file takes the place of `path`.

    `path` is never seen in part, whatever stops the process or the machine: the bytes go to the
    disk first.
    """
    path = path.resolve()
    _remove_abandoned(path.parent)
    aside = path.with_name(f"{_ASIDE}{secrets.token_hex(8)}")
    aside.touch(
        exist_ok=False
    )  # with the permissions any new file has, which `tempfile` would not give
    try:
        yield aside
        _sync(aside, os.O_RDWR)
        aside.replace(path)
    finally:
        with suppress(OSError):
            aside.unlink()  # still there only where it did not take the place
    with suppress(OSError):  # some network file systems, and Windows, refuse it for a folder
        _sync(path.parent, os.O_RDONLY)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file by `whole_file`."""
    with whole_file(path) as aside:
        aside.write_bytes(data)


def _remove_abandoned(folder: Path) -> None:
    """Remove the files and folders that killed runs left aside."""
    for path in folder.glob(f"{_ASIDE}*"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _ABANDONED_AFTER:
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _sync(path: Path, mode: int) -> None:
    handle = os.open(path, mode)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def exclusive(folder: Path, *, wait: bool = True) -> Iterator[None]:
    """Hold a folder alone, among those who ask by this function, where the file system has locks.

    The operating system locks the folder itself, so the lock ends with the process however that
    ends.
    """
    if sys.platform == "win32":
        yield
        return
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            hint = "Wait for it, or choose another folder."
            raise UsageError(
                "another run is writing into it.", file=str(folder), hint=hint
            ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
        yield
    finally:
        os.close(handle)


@contextmanager
def filled_folder(out_dir: str | Path, *, last: str) -> Iterator[Path]:
    """Give an empty folder to write into; its files move to `out_dir` at the end, `last` as the last of them.

    An error inside leaves `out_dir` as it was. A list of the files and their hashes goes with them,
    in the form of ``sha256sum`` and named after `last`. A file of an earlier list that is not
    written again goes, unless somebody changed it. Every other file stays. Of two runs into one
    folder the later one wins.
    """
    if not str(out_dir):
        raise UsageError(
            "the name of the folder to write is empty.", hint="Name one, or leave it out."
        )
    out = Path(out_dir).resolve()
    if out.exists() and not out.is_dir():
        raise UsageError("a folder is needed here, and this is a file.", file=str(out_dir))
    missing = [parent for parent in out.parents if not parent.exists()]
    # Only within one file system is a move all or nothing, and a folder may be where another
    # begins.
    place = out if out.is_dir() else out.parent
    try:
        place.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(place)
        aside = Path(tempfile.mkdtemp(prefix=_ASIDE, dir=place))
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(out_dir)) from error
    try:
        yield aside
        out.mkdir(exist_ok=True)
        with exclusive(out):
            _move(aside, out, last)
    except OSError as error:
        if error.filename is not None and not Path(str(error.filename)).is_relative_to(aside):
            raise
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(out_dir)) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        with suppress(OSError):
            for parent in missing:
                parent.rmdir()  # only where nothing came of it: a folder with something in it stays


def _move(aside: Path, out: Path, last: str) -> None:
    listing = Path(last).with_suffix(".sha256")
    files = sorted(path.relative_to(aside) for path in aside.rglob("*") if path.is_file())
    new = {path: _hash(aside / path) for path in files}
    for path in [*files, listing]:
        _refuse_in_the_way(out, path)
    old = _listed(out / listing)
    lines = [f"{digest}  {path.as_posix()}\n" for path, digest in new.items()]
    (aside / listing).write_text("".join(lines), encoding="utf-8")
    for path in [*(path for path in files if path.name != last), listing, Path(last)]:
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        (aside / path).replace(out / path)
    for path, digest in old.items():
        stale = out / path
        if path not in new and stale.is_file() and _hash(stale) == digest:
            stale.unlink()


def _refuse_in_the_way(out: Path, path: Path) -> None:
    """Refuse before the first move: a folder where a file goes, a file where a folder does."""
    for place, folder in ((path, False), *((parent, True) for parent in path.parents)):
        if (out / place).exists() and (out / place).is_dir() is not folder:
            needed, found = ("folder", "file") if folder else ("file", "folder")
            raise UsageError(
                f"a {needed} is needed here, and this is a {found}.",
                file=str(out / place),
                hint="Rename it, or choose another folder.",
            )


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _listed(path: Path) -> dict[Path, str]:
    """Return what an earlier list names, inside its own folder only."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return {}
    listed = {
        Path(name): digest for digest, _, name in (line.partition("  ") for line in lines) if name
    }
    return {
        path: digest
        for path, digest in listed.items()
        if not path.is_absolute() and ".." not in path.parts
    }
