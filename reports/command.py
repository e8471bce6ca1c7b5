"""What the commands of the reports share: how they end, and how a page is written."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from percept.errors import PerceptError


def run(
    parser: argparse.ArgumentParser,
    work: Callable[[argparse.Namespace], int | None],
    words: Sequence[str] | None = None,
) -> int:
    """Parse the words and do the work; return the exit code.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Its `prog` is the command as it is typed.
    work : callable
        Takes the parsed arguments; `typed` among them is the whole command. It returns an exit
        code, None for 0.
    words : sequence of str, optional
        The words after the command; by default the process's own arguments.

    Returns
    -------
    int
        That of the work, or of what percept refuses.
    """
    words = list(sys.argv[1:] if words is None else words)
    arguments = parser.parse_args(words)
    arguments.typed = f"{parser.prog} {shlex.join(words)}".rstrip()
    try:
        return work(arguments) or 0
    except PerceptError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return error.exit_code


def write_page(path: Path, text: str) -> None:
    """Write a page and print its path; its folder is made where it does not exist."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    print(path)


def say(line: str) -> None:
    """Tell on standard error what is worked on."""
    print(line, file=sys.stderr, flush=True)
