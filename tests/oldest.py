"""Constraints that hold every dependency of percept at its oldest declared version.

python -m tests.oldest pyproject.toml > constraints.txt
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

__all__ = ["oldest"]

#: Extras the tests run with.
EXTRAS = ("tables", "cluster", "test")


def oldest(pyproject: str) -> list[str]:
    """Read the lower bounds of a pyproject.toml.

    Parameters
    ----------
    pyproject : str
        The text of the file.

    Returns
    -------
    list of str
        "name==version", sorted.

    Raises
    ------
    ValueError
        Where a dependency has no lower bound, or two different ones.
    """
    project = tomllib.loads(pyproject)["project"]
    wanted = [*project["dependencies"]]
    for extra in EXTRAS:
        wanted += project["optional-dependencies"][extra]
    found: dict[str, str] = {}
    for requirement in wanted:
        parts = re.fullmatch(
            r"([\w.-]+)(?:\[[\w,]+\])?>=([\w.]+)(?:,.*)?", requirement.replace(" ", "")
        )
        if parts is None:
            raise ValueError(f"{requirement!r} has no lower bound")
        name, version = parts.groups()
        if found.setdefault(name, version) != version:
            raise ValueError(f"{name} has two lower bounds, {found[name]} and {version}")
    return [f"{name}=={version}" for name, version in sorted(found.items())]


if __name__ == "__main__":
    print("\n".join(oldest(Path(sys.argv[1]).read_text(encoding="utf-8"))))
