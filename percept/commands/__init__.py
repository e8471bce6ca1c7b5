"""The commands of the command line, and what they share in `analysis`.

A command is a module with `EXAMPLE`, a line of its help; `add_arguments`, which takes the command's parser;
and `run`, which takes the parsed arguments, prints, and returns the exit code. `run` makes the slow imports.
A short command stands in the module of its like, as a `Command` by its name in capitals.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NamedTuple


class Command(NamedTuple):
    """A command as the parser takes it."""

    description: str | None
    example: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
