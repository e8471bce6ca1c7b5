"""Say what percept runs on: Python, dependencies and their versions, and whether a browser is there."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass

HELP = "check the environment"
EXAMPLE = "percept doctor --json"

#: Names under which a browser that can print a page may be installed.
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")


@dataclass(frozen=True)
class Dependency:
    """A package percept was installed to work with.

    Attributes
    ----------
    name : str
        On the package index.
    version : str or None
        What is installed; None where it is missing.
    extra : str or None
        The optional extra it belongs to; None where percept cannot do without it.
    wanted : str
        The versions that will do, such as ``">=2.0"``.
    fits : bool or None
        Whether the installed version is one of them; None where nothing can compare versions.
    """

    name: str
    version: str | None
    extra: str | None
    wanted: str
    fits: bool | None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the environment; 0 unless a dependency that is always needed is missing or too old."""
    import platform
    import sys

    from percept import __version__

    found = list(dependencies())
    broken = unmet(found)
    browser = find_browser()
    if arguments.json:
        print(
            json.dumps(
                {
                    "percept": __version__,
                    "python": platform.python_version(),
                    "executable": sys.executable,
                    "platform": platform.platform(),
                    "browser": browser,
                    "dependencies": [asdict(one) for one in found],
                    "complete": not broken,
                },
                indent=1,
            )
        )
        return int(bool(broken))
    print(f"percept {__version__}, Python {platform.python_version()}, {platform.platform()}")
    for one in found:
        kind = f"optional ({one.extra})" if one.extra else "needed"
        state = one.version or "missing"
        note = f"  percept wants {one.wanted}" if one.fits is False else ""
        print(f"  {one.name:<16}{state:<14}{kind}{note}")
    print(f"  {'browser':<16}{browser or 'none found':<14}  only for PDF files and tests of the page")
    for one in broken:
        print(f'Install {one.name}: python -m pip install "{one.name}{one.wanted}"')
    if not broken:
        print("Everything percept needs is here.")
    return int(bool(broken))


def dependencies(requirements: Iterable[str] | None = None) -> Iterator[Dependency]:
    """Yield what is asked for, extras included, each package once per extra.

    Parameters
    ----------
    requirements : iterable of str, optional
        As package metadata lists them; percept's own by default.

    Yields
    ------
    Dependency
    """
    import re
    from importlib import metadata

    for line in requirements if requirements is not None else metadata.requires("percept") or ():
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


def unmet(found: Iterable[Dependency]) -> list[Dependency]:
    """Return the dependencies percept cannot do without that are missing or too old."""
    return [one for one in found if one.extra is None and (one.version is None or one.fits is False)]


def _fits(version: str | None, wanted: str) -> bool | None:
    if version is None:
        return False
    try:
        # A dependency of matplotlib, xarray and pytest, so it is there unless the installation is broken.
        from packaging.specifiers import SpecifierSet
    except ImportError:
        return None
    return SpecifierSet(wanted).contains(version, prereleases=True)


def find_browser() -> str | None:
    """Return the path of the first browser found, None without one."""
    import shutil

    return next((path for name in BROWSERS if (path := shutil.which(name))), None)
