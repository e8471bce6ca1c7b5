"""Say what percept runs on: Python, dependencies and their versions, and whether a browser is there."""

from __future__ import annotations

import argparse
import dataclasses
import json
import platform
import re
import sys
from collections.abc import Iterable, Iterator
from importlib import metadata

from percept import __version__
from percept.commands import Command

EXAMPLE = "percept doctor --json"


@dataclasses.dataclass(frozen=True)
class Dependency:
    """A package percept was installed to work with."""

    name: str  # On the package index
    version: str | None  # What is installed
    extra: str | None  # The optional extra it belongs to
    wanted: str  # The versions that will do, such as ``">=2.0"``
    fits: bool | None  # Whether the installed version is one of them; None where nobody can tell


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--all", action="store_true", help="list every dependency with its version")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the environment; 0 unless a dependency that is always needed is missing or too old."""
    from percept.html import find_browser

    packages = list(dependencies(metadata.requires("percept") or ()))
    broken = unmet(packages)
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
            note = f"  percept wants {package.wanted}" if package.version and package.fits is False else ""
            print(f"  {package.name:<16}{package.version or 'missing':<14}{kind}{note}")
    else:
        extras: dict[str | None, list[str]] = {None: []}
        for package in packages:
            lacking = package.version is None or package.fits is False
            extras.setdefault(package.extra, []).extend([package.name] * lacking)
        needed = len(packages) - sum(package.extra is not None for package in packages)
        print(f"needed: {needed - len(broken)} of {needed} packages are here")
        said = [
            f"{extra} lacks {', '.join(names)}" if names else extra
            for extra, names in extras.items()
            if extra
        ]
        print(f"extras: {'; '.join(said)}")
    print(f"browser: {browser or 'none found'}, only for PDF files and tests of the page")
    for package in broken:
        print(f'Install {package.name}: python -m pip install "{package.name}{package.wanted}"')
    if not broken:
        print("Everything percept needs is here.")
    return int(bool(broken))


def dependencies(requirements: Iterable[str]) -> Iterator[Dependency]:
    """Yield what is asked for, extras included, each package once per extra."""
    for line in requirements:
        requirement, _, marker = line.partition(";")
        parts = re.match(r"\s*([\w.-]+)\s*(?:\[[^\]]*\])?\s*\(?([^)]*)\)?", requirement)
        if parts is None:
            continue
        name, wanted = parts[1], parts[2].strip()
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)", marker)
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            version = None
        yield Dependency(name, version, extra[1] if extra else None, wanted, _fits(version, wanted))


def unmet(packages: Iterable[Dependency]) -> list[Dependency]:
    """Return the dependencies percept cannot do without that are missing or too old."""
    needed = (package for package in packages if package.extra is None)
    return [package for package in needed if package.version is None or package.fits is False]


def _fits(version: str | None, wanted: str) -> bool | None:
    if version is None:
        return False
    try:
        # A dependency of matplotlib and xarray: missing where the installation is broken, as it may be here.
        from packaging.specifiers import SpecifierSet
    except ImportError:
        return None
    return SpecifierSet(wanted).contains(version, prereleases=True)


_COMPLETION_EXAMPLE = """eval "$(percept completion bash)"                         # bash, in ~/.bashrc
  eval "$(percept completion zsh)"                          # zsh, in ~/.zshrc after compinit
  percept completion tcsh > ~/.percept.csh                  # tcsh, then source it in ~/.tcshrc"""
_PATHS = ("PATH", "FILE", "DIR")


def _add_shell(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="for which shell")


def _complete(arguments: argparse.Namespace) -> int:
    """Print the script; files are completed wherever a command takes paths."""
    import shtab

    from percept.cli import build_parser

    print(shtab.complete(_with_files(build_parser()), shell=arguments.shell))
    return 0


def _with_files(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """Mark arguments that take paths, in every command, so that the shell offers files."""
    import shtab

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _with_files(command)
        elif action.metavar in _PATHS:
            action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE  # type: ignore[attr-defined]
    return parser


COMPLETION = Command(
    "Print a completion script for a shell, to be evaluated or saved where the shell looks for it.",
    _COMPLETION_EXAMPLE,
    _add_shell,
    _complete,
)
