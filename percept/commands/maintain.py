"""`percept doctor`, `cache` and `completion`: the installation, what it keeps, and the shell."""

from __future__ import annotations

import argparse
import platform
import re
from importlib import metadata
from typing import NamedTuple

from percept import __version__
from percept.commands import Command, argument, flag
from percept.errors import UsageError, counted

_CACHE = """Show what posteriors are kept for next time, or clear them.

PERCEPT_CACHE names another folder, or turns the cache off with the word "off". Beyond a gigabyte the
posteriors not used for longest go.
"""


class Dependency(NamedTuple):
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


def _doctor(arguments: argparse.Namespace) -> int:
    """Print the environment; 1 where a dependency that is always needed is missing or too old."""
    from percept.cache import cache_folder

    packages = [dependency(line) for line in metadata.requires("percept") or ()]
    needed = [package for package in packages if package.extra is None]
    broken = [package for package in needed if not package.fits]
    print(f"percept {__version__}, Python {platform.python_version()}, {platform.platform()}")
    if arguments.all:
        for package in packages:
            kind = f"optional ({package.extra})" if package.extra else "needed"
            print(f"  {package.name:<16}{package.version or 'missing':<14}{kind} {package.wanted}")
    print(f"needed: {len(needed) - len(broken)} of {len(needed)} packages are here")
    lacking: dict[str, list[str]] = {package.extra: [] for package in packages if package.extra}
    for package in packages:
        if package.extra and not package.fits:
            lacking[package.extra].append(package.name)
    extras = [f"{name} lacks {', '.join(lacks)}" if lacks else name for name, lacks in lacking.items()]
    print(f"extras: {'; '.join(extras)}")
    print(f"cache: {cache_folder() or 'off'}")
    for package in broken:
        print(f'Install {package.name}: python -m pip install "{package.name}{package.wanted}"')
    if not broken:
        print("Everything percept needs is here.")
    return int(bool(broken))


def _cache(arguments: argparse.Namespace) -> None:
    """Print the folder, how many posteriors it keeps and their size, or clear it."""
    from percept.cache import PosteriorCache, cache_folder

    folder = cache_folder()
    if folder is None:
        hint = "Unset it, or let it name a folder."
        raise UsageError("the cache is turned off.", key="PERCEPT_CACHE", value="off", hint=hint)
    if folder.exists() and not folder.is_dir():
        hint = "Let PERCEPT_CACHE name another."
        raise UsageError("a folder is needed here, and this is a file.", file=str(folder), hint=hint)
    cache = PosteriorCache(folder)
    if arguments.action == "clear":
        print(f"{folder}: {counted(cache.clear(), 'posterior')} removed")
        return
    entries = cache.entries()
    megabytes = sum(entry.size for entry in entries) / 1e6
    print(f"{folder}: {counted(len(entries), 'posterior')}, {megabytes:.1f} of {cache.limit / 1e6:.0f} MB")


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
    "Say what percept runs on: Python, its dependencies and their versions, and the cache.",
    "percept doctor --all",
    (flag("--all", "list every dependency with its version"),),
    _doctor,
)
CACHE = Command(
    _CACHE,
    "percept cache clear",
    (argument("action", None, "what to do (show)", nargs="?", choices=("show", "clear"), default="show"),),
    _cache,
)
COMPLETION = Command(
    "Print a completion script for a shell, to be evaluated or saved where the shell looks for it.",
    """eval "$(percept completion bash)"                         # bash, in ~/.bashrc
  eval "$(percept completion zsh)"                          # zsh, in ~/.zshrc after compinit
  percept completion tcsh > ~/.percept.csh                  # tcsh, then source it in ~/.tcshrc""",
    (argument("shell", None, "for which shell", choices=("bash", "zsh", "tcsh")),),
    _completion,
)
