"""The environment of a process whose start is timed."""

from __future__ import annotations

import os


def as_installed(**changes: str) -> dict[str, str]:
    """Return this process's environment, changed, in which percept's modules are kept compiled.

    Installed packages are compiled as they are installed. percept run from its checkout would be compiled
    again at every start where `PYTHONDONTWRITEBYTECODE` is set.
    """
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | changes
