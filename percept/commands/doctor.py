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
    for package in packages:
        kind = f"optional ({package.extra})" if package.extra else "needed"
        note = f"  percept wants {package.wanted}" if package.version and package.fits is False else ""
        print(f"  {package.name:<16}{package.version or 'missing':<14}{kind}{note}")
    print(f"  {'browser':<16}{browser or 'none found':<14}  only for PDF files and tests of the page")
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
