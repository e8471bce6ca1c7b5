"""What a page of results was made by: command, date, the commit of the code, and versions."""

from __future__ import annotations

import dataclasses
import datetime
import importlib.metadata
import platform
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

from percept import __version__

_PACKAGE = Path(__file__).resolve().parent
_PACKAGES = ("numpy", "scipy", "emcee", "pandas", "arviz-base", "arviz-stats")


@dataclasses.dataclass(frozen=True)
class Made:
    """How a page came about."""

    command: str  # As typed
    date: str
    commit: str  # The last one that touched the code; empty where the code is not in a repository
    versions: dict[str, str]  # Of percept, Python and the packages that matter

    @property
    def sentence(self) -> str:
        """All of it in Markdown."""
        commit = f" from commit {self.commit}" if self.commit else ""
        versions = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        return f"Made on {self.date} by `{self.command}`{commit}. {versions}."


def made_by(command: str, packages: Iterable[str] = _PACKAGES) -> Made:
    """Record what a page is made by, now.

    Parameters
    ----------
    command : str
        As typed.
    packages : iterable of str
        Whose versions are recorded, where they are installed.

    Returns
    -------
    Made
        With today's date, and the commit of the code where it is in a repository.
    """
    installed = {}
    for package in importlib.metadata.distributions():
        installed[package.name.lower()] = package.version
    versions = {"percept": __version__, "Python": platform.python_version()}
    versions |= {name: installed[name] for name in packages if name in installed}
    return Made(command, datetime.date.today().isoformat(), commit_of_code(), versions)


def commit_of_code() -> str:
    """Return the last commit that touched the package, and whether files differ from it."""
    if not (_PACKAGE.parent / ".git").exists():
        return ""
    try:
        commit = _git("log", "-1", "--format=%h", "--abbrev=12")
        return f"{commit} with changes" if _git("status", "--porcelain") else commit
    except (OSError, subprocess.CalledProcessError):
        return ""


def _git(*words: str) -> str:
    done = subprocess.run(
        ["git", *words, "--", str(_PACKAGE)],
        cwd=_PACKAGE,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Write a table in Markdown.

    Parameters
    ----------
    heads : sequence of str
        Of the columns.
    rows : iterable of sequences
        Their cells, written as text.

    Returns
    -------
    str
        Every line of it ends.
    """
    lines = [f"| {' | '.join(map(str, cells))} |\n" for cells in (heads, *rows)]
    lines.insert(1, f"|{'---|' * len(heads)}\n")
    return "".join(lines)
