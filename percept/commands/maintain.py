"""`percept doctor`, `cache` and `completion`: the installation, what it keeps, and the shell."""

from __future__ import annotations

import argparse
import dataclasses
import datetime
import json
import platform
import re
import sys
from importlib import metadata

from percept import __version__
from percept.commands import Command
from percept.errors import UsageError, counted

_CACHE = """Show what posteriors are kept for next time, or clear them.

PERCEPT_CACHE names another folder, or turns the cache off with the word "off". PERCEPT_CACHE_LIMIT is how
many megabytes it may take (1000); the posteriors not used for longest go first.
"""


def _add_doctor(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--all", action="store_true", help="list every dependency with its version")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def _doctor(arguments: argparse.Namespace) -> int:
    """Print the environment; 1 where a dependency that is always needed is missing or too old."""
    from percept.html import find_browser

    packages = [dependency(line) for line in metadata.requires("percept") or ()]
    needed = [package for package in packages if package.extra is None]
    broken = [package for package in needed if not package.fits]
    browser = find_browser()
    if arguments.json:
        report = {
            "percept": __version__,
            "python": platform.python_version(),
            "executable": sys.executable,
            "platform": platform.platform(),
            "browser": browser,
            "dependencies": [dataclasses.asdict(package) for package in packages],
            "complete": not broken,
        }
        print(json.dumps(report, indent=1))
        return int(bool(broken))
    print(f"percept {__version__}, Python {platform.python_version()}, {platform.platform()}")
    if arguments.all:
        for package in packages:
            kind = f"optional ({package.extra})" if package.extra else "needed"
            note = f"  percept wants {package.wanted}" if package.version and not package.fits else ""
            print(f"  {package.name:<16}{package.version or 'missing':<14}{kind}{note}")
    else:
        print(f"needed: {len(needed) - len(broken)} of {len(needed)} packages are here")
        extras = {package.extra: list[str]() for package in packages if package.extra}
        for package in packages:
            if package.extra and not package.fits:
                extras[package.extra].append(package.name)
        said = [f"{extra} lacks {', '.join(names)}" if names else extra for extra, names in extras.items()]
        print(f"extras: {'; '.join(said)}")
    print(f"browser: {browser or 'none found'}, only for PDF files and tests of the page")
    for package in broken:
        print(f'Install {package.name}: python -m pip install "{package.name}{package.wanted}"')
    if not broken:
        print("Everything percept needs is here.")
    return int(bool(broken))


@dataclasses.dataclass(frozen=True)
class Dependency:
    """A package percept was installed to work with."""

    name: str  # On the package index
    version: str | None  # What is installed
    extra: str | None  # The optional extra it belongs to
    wanted: str  # The versions that will do, such as ``">=2.0"``
    fits: bool  # Whether the installed version is one of them


def dependency(line: str) -> Dependency:
    """Read a requirement as metadata writes it, and look up what is installed."""
    from packaging.requirements import Requirement

    requirement = Requirement(line)
    extra = re.search(r"extra == .([\w-]+)", str(requirement.marker or ""))
    try:
        version = metadata.version(requirement.name)
    except metadata.PackageNotFoundError:
        version = None
    fits = version is not None and requirement.specifier.contains(version, prereleases=True)
    wanted = ",".join(sorted(map(str, requirement.specifier), reverse=True))
    return Dependency(requirement.name, version, extra[1] if extra else None, wanted, fits)


def _add_cache(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "action", nargs="?", choices=("show", "clear"), default="show", help="what to do (show)"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def _cache(arguments: argparse.Namespace) -> None:
    """Print the folder, its size and entries, or clear it."""
    from percept.cache import PosteriorCache, cache_folder

    folder = cache_folder()
    if folder is None:
        raise UsageError(
            "the cache is turned off.",
            key="PERCEPT_CACHE",
            value="off",
            hint="Unset it, or let it name a folder.",
        )
    if folder.exists() and not folder.is_dir():
        raise UsageError(
            "a folder is needed here, and this is a file.",
            file=str(folder),
            hint="Let PERCEPT_CACHE name another.",
        )
    cache = PosteriorCache(folder)
    if arguments.action == "clear":
        removed = cache.clear()
        told = {"folder": str(folder), "removed": removed}
        print(json.dumps(told) if arguments.json else f"{folder}: {counted(removed, 'posterior')} removed")
        return
    entries = cache.entries()
    total = sum(entry.size for entry in entries)
    if arguments.json:
        listed = [{"key": entry.key, "bytes": entry.size, "used_ns": entry.used} for entry in entries]
        kept = {"folder": str(folder), "bytes": total, "limit": cache.limit, "entries": listed}
        print(json.dumps(kept, indent=1))
        return
    posteriors = counted(len(entries), "posterior")
    print(f"{folder}: {posteriors}, {total / 1e6:.1f} of {cache.limit / 1e6:.0f} MB")
    for entry in reversed(entries):
        used = datetime.datetime.fromtimestamp(entry.used / 1e9).isoformat(" ", "minutes")
        print(f"  {entry.key[:16]}  {entry.size / 1e6:8.1f} MB  last used {used}")


def _add_completion(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="for which shell")


def _completion(arguments: argparse.Namespace) -> None:
    """Print the script; files are completed wherever a command takes paths."""
    import shtab

    from percept.cli import build_parser

    parser = build_parser()
    (commands,) = (action for action in parser._actions if action.dest == "command")
    assert isinstance(commands.choices, dict)
    offered = {"PATH": shtab.FILE, "FILE": shtab.FILE, "DIR": shtab.DIRECTORY}
    for command in commands.choices.values():
        for action in command._actions:
            if action.metavar in offered:
                action.complete = offered[action.metavar]
    print(shtab.complete(parser, shell=arguments.shell))


DOCTOR = Command(
    "Say what percept runs on: Python, dependencies and their versions, and whether a browser is there.",
    "percept doctor --json",
    _add_doctor,
    _doctor,
)
CACHE = Command(_CACHE, "percept cache clear", _add_cache, _cache)
COMPLETION = Command(
    "Print a completion script for a shell, to be evaluated or saved where the shell looks for it.",
    """eval "$(percept completion bash)"                         # bash, in ~/.bashrc
  eval "$(percept completion zsh)"                          # zsh, in ~/.zshrc after compinit
  percept completion tcsh > ~/.percept.csh                  # tcsh, then source it in ~/.tcshrc""",
    _add_completion,
    _completion,
)
