"""The commands of the command line, a module per job, and what they share in `analysis`.

A command is a `Command` under its name in capitals. Its `run` takes the parsed arguments, makes the
slow imports, prints, and returns the exit code, None for 0.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

__all__ = [
    "FORCE",
    "JSON",
    "QUIET",
    "Argument",
    "Command",
    "argument",
    "flag",
    "folder",
    "number",
]


class Argument(NamedTuple):
    """An argument of a command, as argparse takes it."""

    name: str
    settings: dict[str, Any]


class Command(NamedTuple):
    """A command as the parser takes it."""

    description: str
    example: str
    arguments: Sequence[Argument]
    run: Callable[[argparse.Namespace], int | None]


def argument(name: str, metavar: str | None, help: str, **settings: Any) -> Argument:
    """Describe an argument with a value, text unless its `type` says otherwise."""
    # Not even None may be given to a flag with a --no- twin from Python 3.14 on.
    if metavar is not None:
        settings["metavar"] = metavar
    return Argument(name, {"help": help, **settings})


def flag(name: str, help: str) -> Argument:
    """Describe an option that is given or not."""
    return Argument(name, {"action": "store_true", "help": help})


def number(name: str, metavar: str, help: str, **settings: Any) -> Argument:
    """Describe an option that takes a number: an integer where it is called N."""
    return argument(name, metavar, help, type=int if metavar == "N" else float, **settings)


def folder(default: str) -> Argument:
    """Describe the folder that a command writes into."""
    return argument("--out", "DIR", f"folder to write into ({default})", default=default)


JSON = flag("--json", "print as JSON")
FORCE = flag("--force", "write also into a folder with files that percept did not write")
QUIET = flag("--quiet", "no progress, no notices")
