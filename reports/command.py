"""What the commands of the reports share: what was typed, and what a refusal looks like."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence

from percept.errors import PerceptError


def run(
    parser: argparse.ArgumentParser,
    work: Callable[[argparse.Namespace], None],
    words: Sequence[str] | None = None,
) -> int:
    """Parse the words and do the work; return the exit code.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Its `prog` is the command as it is typed.
    work : callable
        Takes the parsed arguments; `typed` among them is the whole command.
    words : sequence of str, optional
        The words after the command; by default the process's own arguments.

    Returns
    -------
    int
        0, or the exit code of what percept refuses.
    """
    words = list(sys.argv[1:] if words is None else words)
    arguments = parser.parse_args(words)
    arguments.typed = f"{parser.prog} {shlex.join(words)}".rstrip()
    try:
        work(arguments)
    except PerceptError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return error.exit_code
    return 0
