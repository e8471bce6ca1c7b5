"""Say what percept runs on: Python, dependencies and their versions, and whether a browser is there."""

from __future__ import annotations

import argparse

EXAMPLE = "percept doctor --json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the environment; 0 unless a dependency that is always needed is missing or too old."""
    import dataclasses
    import json
    import platform
    import sys

    from percept import __version__
    from percept.commands.dependencies import dependencies, unmet
    from percept.html import find_browser

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
                    "dependencies": [dataclasses.asdict(one) for one in found],
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
