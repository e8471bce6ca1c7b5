"""Files that are whole or not there, folders that one run holds, and results moved into place."""

from __future__ import annotations

import dataclasses
import errno
import fnmatch
import hashlib
import os
import secrets
import shutil
import stat
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePath

from percept.errors import UsageError

__all__ = [
    "FolderFiles", "exclusive", "filled_folder", "refuse_foreign", "warned", "whole_file",
    "write_whole",
]  # fmt: skip

_ASIDE = ".percept-unfinished-"
# Where locks cannot tell whether its run goes on, what lies aside for longer was left by a dead
# one.
_ABANDONED_AFTER = 86_400.0  # s
# Errors of a file system without locks, such as NFS before version 4.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


@dataclasses.dataclass(frozen=True)
class FolderFiles:
    """The files that a command writes into a folder, and may replace there.

    Parameters
    ----------
    last : str
        The file that is complete only when all others are; the list of digests has its name.
    names : tuple of str
        Patterns of every file the command can write, `last` among them, such as
        ``"tables/data_*.csv"``.
    """

    last: str
    names: tuple[str, ...]

    @property
    def listing(self) -> str:
        """Name of the list of digests, in the form of ``sha256sum``."""
        return str(Path(self.last).with_suffix(".sha256"))

    def has(self, name: str) -> bool:
        """Say whether the command can write a file of this name."""
        depth = name.count("/")
        # A star of `fnmatch` reaches over folders.
        return any(
            pattern.count("/") == depth and fnmatch.fnmatchcase(name, pattern)
            for pattern in self.names
        )


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a hidden name beside `path` to write to; at the end that file takes the place of `path`.

    `path` is never seen in part, whatever stops the process or the machine: the bytes go to the
    disk first.
    """
    path = path.resolve()
    _remove_abandoned(path.parent)
    aside = path.with_name(f"{_ASIDE}{secrets.token_hex(8)}")
    # With the permissions any new file has, which `tempfile` would not give.
    aside.touch(exist_ok=False)
    try:
        with exclusive(aside):
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
    """Remove old files and folders of dead runs; a living run holds a lock on its own."""
    for path in folder.glob(f"{_ASIDE}*"):
        with suppress(OSError, UsageError):
            if time.time() - path.stat().st_mtime < _ABANDONED_AFTER:
                continue
            with exclusive(path, wait=False):
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


def warned(message: str) -> None:
    """Say something as a Python warning."""
    warnings.warn(message, UserWarning, stacklevel=2)


@contextmanager
def filled_folder(
    out_dir: str | Path,
    files: FolderFiles,
    *,
    force: bool = False,
    say: Callable[[str], None] = warned,
) -> Iterator[Path]:
    """Give an empty folder to fill; its files move to `out_dir` at the end, `files.last` last.

    An error inside leaves `out_dir` as it was. A list of the files and their digests goes with
    them. Only what an earlier list names is replaced, or removed where it is not written again;
    what somebody edited since is kept beside as NAME.bak. Every other file stays. Of two runs into
    one folder the later one wins.

    Parameters
    ----------
    out_dir : str or Path
        The folder, made where it does not exist.
    files : FolderFiles
        What may be written, replaced and removed.
    force : bool
        Replace also files of these names that no earlier run wrote.
    say : callable
        Told of each edited file that is kept; a warning by default.

    Yields
    ------
    Path
        An empty folder on the same file system.

    Raises
    ------
    UsageError
        Before anything is written inside: a name in `out_dir` is taken by a file that no earlier
        run wrote, by a link or by a folder. At the end too, or where `out_dir` cannot be written.
    """
    out = _folder(out_dir)
    refuse_foreign(out_dir, files, force=force)
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
        with exclusive(aside):
            yield aside
            out.mkdir(exist_ok=True)
            with exclusive(out):
                refuse_foreign(out_dir, files, force=force)
                _move(aside, out, files, say)
    except OSError as error:
        if error.filename is not None and not Path(str(error.filename)).is_relative_to(aside):
            raise
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(out_dir)) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        with suppress(OSError):
            for parent in missing:
                parent.rmdir()  # only where nothing came of it: a folder with something in it stays


def refuse_foreign(out_dir: str | Path, files: FolderFiles, *, force: bool = False) -> None:
    """Refuse a folder in which a name that a command writes is taken by what it did not write.

    Parameters
    ----------
    out_dir : str or Path
        The folder; it need not exist.
    files : FolderFiles
        What the command writes.
    force : bool
        Take regular files and links to files for the command's own.

    Raises
    ------
    UsageError
        With the name of the first such file.
    """
    out = _folder(out_dir)
    known = {*_digests(out, files)}
    if _is_listing(_listed(out / files.listing), files):
        known.add(files.listing)
    for folder in {PurePath(name).parent for name in files.names}:
        _refuse_unless_folder(out / folder)
        for path in (out / folder).iterdir() if (out / folder).is_dir() else ():
            name = path.relative_to(out).as_posix()
            if files.has(name) or name == files.listing:
                _refuse_unless_file(path, ours=name in known, force=force)


def _refuse_unless_folder(path: Path) -> None:
    """Refuse a link, or anything but a folder, where files of a command go into a folder."""
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        found = "link" if path.is_symlink() else "file"
        raise UsageError(
            f"a folder is needed here, and this is a {found}.",
            file=str(path),
            hint="Rename it, or choose another folder.",
        )


def _refuse_unless_file(path: Path, *, ours: bool, force: bool) -> None:
    """Refuse what is no file, and what no earlier run wrote."""
    mode = path.lstat().st_mode
    if stat.S_ISDIR(mode):
        raise UsageError(
            "a file is needed here, and this is a folder.",
            file=str(path),
            hint="Rename it, or choose another folder.",
        )
    if force or (ours and stat.S_ISREG(mode)):
        return
    found = "is a link" if stat.S_ISLNK(mode) else "was not written by an earlier run"
    raise UsageError(
        f"{found}, and would be replaced.",
        file=str(path),
        hint="Rename it, choose another folder, or replace it with --force.",
    )


def _folder(out_dir: str | Path) -> Path:
    """Return the folder without links; refuse a name that can be none."""
    if not str(out_dir):
        raise UsageError(
            "the name of the folder to write is empty.", hint="Name one, or leave it out."
        )
    out = Path(out_dir).resolve()
    if out.exists() and not out.is_dir():
        raise UsageError("a folder is needed here, and this is a file.", file=str(out_dir))
    return out


def _move(aside: Path, out: Path, files: FolderFiles, say: Callable[[str], None]) -> None:
    """Move files into place, and remove what an earlier run wrote and this one did not."""
    written = sorted(path.relative_to(aside) for path in aside.rglob("*") if path.is_file())
    new = {path.as_posix(): _digest(aside / path) for path in written}
    earlier = _digests(out, files)
    stale = {*_listed(out / files.listing)} & earlier.keys() - new.keys()
    for name in sorted({*new, *stale} & earlier.keys()):
        path = out / name
        if path.is_file() and not path.is_symlink() and _digest(path) not in earlier[name]:
            kept = _free_name(path)
            path.rename(kept)
            say(f"{path} was edited since percept wrote it, and is kept as {kept.name}.")
    # A run that is killed while it moves files leaves a list of both runs' files.
    _write_listing(aside, out, files, [*_lines(earlier), *_lines({n: {d} for n, d in new.items()})])
    for name in [*(name for name in new if name != files.last), files.last]:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (aside / name).replace(out / name)
    for name in stale:
        if (out / name).is_file() and not (out / name).is_symlink():
            (out / name).unlink()
    _write_listing(aside, out, files, _lines({name: {digest} for name, digest in new.items()}))


def _write_listing(aside: Path, out: Path, files: FolderFiles, lines: list[str]) -> None:
    (aside / files.listing).write_text("".join(lines), encoding="utf-8")
    (aside / files.listing).replace(out / files.listing)


def _lines(digests: dict[str, set[str]]) -> list[str]:
    return [f"{digest}  {name}\n" for name in digests for digest in sorted(digests[name])]


def _free_name(path: Path) -> Path:
    """Return NAME.bak, or the first of NAME.bak2, NAME.bak3 … that is not there."""
    kept = path.with_name(f"{path.name}.bak")
    count = 1
    while os.path.lexists(kept):
        count += 1
        kept = path.with_name(f"{path.name}.bak{count}")
    return kept


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _digests(out: Path, files: FolderFiles) -> dict[str, set[str]]:
    """Return the digests that the lists in a folder give to a command's files.

    Every list counts: `percept fit` and `percept report` both write posterior.nc.
    """
    digests: dict[str, set[str]] = {}
    for path in sorted(out.glob("*.sha256")):
        listed = _listed(path)
        if path.name == files.listing and not _is_listing(listed, files):
            continue
        for name in filter(files.has, listed):
            digests.setdefault(name, set()).update(listed[name])
    return digests


def _listed(path: Path) -> dict[str, set[str]]:
    """Return the names of a list with their digests; nothing where it is a link or no text."""
    digests: dict[str, set[str]] = {}
    if path.is_symlink() or not path.is_file():
        return digests
    with suppress(OSError, UnicodeDecodeError):
        for line in path.read_text(encoding="utf-8").splitlines():
            digest, _, name = line.partition("  ")
            digests.setdefault(name, set()).add(digest)
    return digests


def _is_listing(listed: Mapping[str, set[str]], files: FolderFiles) -> bool:
    """Say whether a list is of an earlier run: it names that command's files and no others."""
    return files.last in listed and all(map(files.has, listed))
