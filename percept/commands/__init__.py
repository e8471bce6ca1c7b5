"""The commands of the command line, a module per job, and what they share in `analysis`.

A command is a `Command` under its name in capitals. Its `run` takes the parsed arguments, makes the slow
imports, prints, and returns the exit code, None for 0.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NamedTuple


class Command(NamedTuple):
    """A command as the parser takes it."""

    description: str
    example: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int | None]
