"""Files that are whole or not there, folders that one run holds, and results moved into place."""

from __future__ import annotations

import fnmatch
import os
import secrets
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from percept.errors import UsageError

#: A folder with this file is percept's own. It lists, line by line, what percept wrote there.
MARKER = ".percept"
_HEADER = "# percept wrote these files. It replaces and removes them.\n"
_ASIDE = ".percept-unfinished-"
# s that a run waits for another one, which moves its files in less.
_PATIENCE = 10.0
# Beginnings of what a spreadsheet runs, spaces before them passed over; some take wide forms too.
_FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠")


def fits(name: str, patterns: Sequence[str]) -> bool:
    """Say whether a file's name, with its folders, fits one of the patterns."""
    depth = name.count("/")
    # A star of `fnmatch` reaches over folders.
    return any(
        pattern.count("/") == depth and fnmatch.fnmatchcase(name, pattern) for pattern in patterns
    )


def write_whole(path: Path, data: bytes) -> None:
    """Write a file that is never seen in part, whatever stops the process or the machine.

    A hidden file beside it takes its place, when the bytes are on the disk.
    """
    path = path.resolve()
    aside = path.with_name(f"{_ASIDE}{secrets.token_hex(8)}")
    try:
        # With the permissions any new file has, which `tempfile` would not give.
        with aside.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        aside.replace(path)
    finally:
        with suppress(OSError):
            aside.unlink()  # still there only where it did not take the place
    with suppress(OSError):  # some network file systems, and Windows, refuse it for a folder
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def inert(text: str) -> str:
    """Put a mark before a text that a spreadsheet would run."""
    runs = text.lstrip().startswith(_FORMULA) or text.startswith(("\t", "\r"))
    return f"'{text}" if runs else text


@contextmanager
def exclusive(folder: Path, *, wait: bool = True) -> Iterator[None]:
    """Hold a folder alone, among those who ask by this function.

    The operating system locks the folder itself, so the lock ends with the process however that
    ends. Some file systems have no locks, and hold nobody up.

    Raises
    ------
    UsageError
        Another run holds it; where this one waits, for 10 s.
    """
    if sys.platform == "win32":
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        _lock(handle, folder, time.monotonic() + wait * _PATIENCE)
        yield
    finally:
        os.close(handle)


def _lock(handle: int, folder: Path, deadline: float) -> None:
    """Lock an open folder until a time of the monotonic clock, where there are locks."""
    import fcntl

    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= deadline:
                raise UsageError(
                    "another run is writing into it.",
                    file=str(folder),
                    hint="Wait for it, or choose another folder.",
                ) from None
            time.sleep(0.05)
            continue
        except OSError:
            # Such as NFS before version 4.
            pass
        return


@contextmanager
def filled_folder(
    out_dir: str | Path, patterns: Sequence[str], *, force: bool = False
) -> Iterator[Path]:
    """Give an empty folder to fill; its files move to `out_dir` at the end.

    An error inside leaves `out_dir` as it was. What an earlier run of the command wrote there is
    replaced, or removed where it is not written again. Every other file stays. Of two runs into one
    folder the later one wins.

    Parameters
    ----------
    out_dir : str or Path
        The folder, made where it does not exist.
    patterns : sequence of str
        Of every file that may be written, replaced and removed, such as ``"tables/data_*.csv"``.
        The first file moves last: it is complete only when all others are.
    force : bool
        Take a folder with files that are not percept's.

    Yields
    ------
    Path
        An empty folder on the same file system.

    Raises
    ------
    UsageError
        Before anything is written inside: see `refuse_foreign`. At the end too, or where `out_dir`
        cannot be written.
    """
    refuse_foreign(out_dir, patterns, force=force)
    out = _folder(out_dir)
    # Only within one file system is a move all or nothing, and a folder may be where another
    # begins.
    place = out if out.is_dir() else out.parent
    try:
        place.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=_ASIDE, dir=place))
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(out_dir)) from error
    try:
        yield aside
        out.mkdir(exist_ok=True)
        with exclusive(out):
            refuse_foreign(out_dir, patterns, force=force)
            _move(aside, out, patterns)
    except OSError as error:
        if error.filename is not None and not Path(str(error.filename)).is_relative_to(aside):
            raise
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(out_dir)) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def own_folder(out_dir: str | Path, *, force: bool = False) -> Path:
    """Make a folder where there is none, and mark it as percept's; see `refuse_foreign`."""
    refuse_foreign(out_dir, force=force)
    out = _folder(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    if not (out / MARKER).exists():
        write_whole(out / MARKER, _HEADER.encode())
    return out


def refuse_foreign(
    out_dir: str | Path, patterns: Sequence[str] = (), *, force: bool = False
) -> None:
    """Refuse a folder with files that is not percept's own.

    Parameters
    ----------
    out_dir : str or Path
        The folder; it need not exist.
    patterns : sequence of str
        What is written into it.
    force : bool
        Take it all the same.

    Raises
    ------
    UsageError
        It holds files, and percept's marker is not among them; hidden files do not count. Or a link
        or a file is where a folder is needed.
    """
    out = _folder(out_dir)
    for name in patterns:
        _refuse_unless_folder((out / name).parent)
    if force or not out.is_dir() or (out / MARKER).is_file():
        return
    foreign = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
    if foreign:
        raise UsageError(
            f"the folder holds what percept did not write, such as {foreign[0]}.",
            file=str(out_dir),
            hint="Choose another folder. --force writes into this one, and replaces files of the"
            " same names.",
        )


def _refuse_unless_folder(path: Path) -> None:
    """Refuse a link, or anything but a folder, where files of a command go into a folder."""
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        found = "link" if path.is_symlink() else "file"
        raise UsageError(
            f"a folder is needed here, and this is a {found}.",
            file=str(path),
            hint="Rename it, or choose another folder.",
        )


def _folder(out_dir: str | Path) -> Path:
    """Return the folder without links; refuse a name that can be none."""
    if not str(out_dir):
        raise UsageError(
            "the name of the folder to write is empty.", hint="Name one, or leave it out."
        )
    out = Path(out_dir).resolve()
    _refuse_unless_folder(out)
    return out


def _move(aside: Path, out: Path, patterns: Sequence[str]) -> None:
    """Move files into place, and remove what an earlier run wrote and this one did not."""
    written = [path.relative_to(aside).as_posix() for path in aside.rglob("*") if path.is_file()]
    for name in written:
        if (out / name).is_dir() and not (out / name).is_symlink():
            raise UsageError(
                "a file is needed here, and this is a folder.",
                file=str(out / name),
                hint="Rename it, or choose another folder.",
            )
    listed = _listed(out)
    stale = {name for name in listed if fits(name, patterns)} - {*written}
    # A run that is killed while it moves files leaves a list of both runs' files.
    _mark(aside, out, listed | {*written})
    for name in sorted(written, key=lambda name: name == patterns[0]):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (aside / name).replace(out / name)
    for name in stale:
        if (out / name).is_file() and not (out / name).is_symlink():
            (out / name).unlink()
    _mark(aside, out, (listed | {*written}) - stale)


def _listed(out: Path) -> set[str]:
    """Return what the marker of a folder lists; nothing where it is none of percept's."""
    with suppress(OSError, UnicodeDecodeError):
        lines = (out / MARKER).read_text(encoding="utf-8").splitlines()
        return {line for line in lines if not line.startswith("#")}
    return set()


def _mark(aside: Path, out: Path, names: Iterable[str]) -> None:
    """Mark a folder as percept's, and list what percept wrote there."""
    lines = [f"{name}\n" for name in sorted(names)]
    (aside / MARKER).write_text("".join([_HEADER, *lines]), encoding="utf-8")
    (aside / MARKER).replace(out / MARKER)
