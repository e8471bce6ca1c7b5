"""What percept was installed to work with, and what of it is here."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import metadata


@dataclass(frozen=True)
class Dependency:
    """A package percept was installed to work with."""

    name: str  # On the package index
    version: str | None  # What is installed
    extra: str | None  # The optional extra it belongs to
    wanted: str  # The versions that will do, such as ``">=2.0"``
    fits: bool | None  # Whether the installed version is one of them


def dependencies(requirements: Iterable[str] | None = None) -> Iterator[Dependency]:
    """Yield what is asked for, extras included, each package once per extra."""
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
