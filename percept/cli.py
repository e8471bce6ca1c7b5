"""The command line: parse, call, print. Each command is a module of `percept.commands`."""

from __future__ import annotations

import argparse
import atexit
import gc
import importlib
import io
import os
import shlex
import signal
import sys
import threading
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from percept import __version__
from percept.commands import Command
from percept.errors import PerceptError, UsageError, did_you_mean, printable

#: Commands by what they are for, each with its module of `percept.commands` and a line of help.
GROUPS = {
    "analyse": {
        "report": ("fit", "analyse sessions and write the report"),
        "fit": ("fit", "fit the model and print its intervals"),
        "compare": ("compare", "compare methods, or two studies, groups or devices"),
        "predict": ("fit", "predict an untested environment"),
        "batch": ("fit", "fit many studies, on this machine or a cluster"),
    },
    "design": {
        "plan": ("design", "plan the number of subjects"),
        "calibrate": ("design", "simulate, refit and report real coverage"),
        "zwidth": ("design", "what a device renders with every hand"),
    },
    "data": {
        "new": ("data", "write a commented scene file"),
        "validate": ("data", "check session files and say what they hold"),
        "simulate": ("data", "simulate sessions like a published table"),
    },
    "maintain": {
        "doctor": ("data", "check the installation, the cache and shell completion"),
    },
}
COMMANDS = {name: entry for group in GROUPS.values() for name, entry in group.items()}
# Commands that keep what is finished when they are interrupted.
_RESUMED = ("batch", "calibrate")
# Exit codes as a shell gives them to what a signal ends: 128 + SIGINT, + SIGPIPE, and + SIGTERM.
_INTERRUPTED = 130
_UNREAD = 141
_TERMINATED = 143

_EXAMPLE = """example:
  percept report sessions/ --scene scene.toml --out results

percept help COMMAND says more about a command.
"""


class _Parser(argparse.ArgumentParser):
    """Reports a mistake in a line of its own; the help of `percept` lists commands in groups."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}. See {self.prog} --help.\n")

    def format_help(self) -> str:
        if self.prog != "percept":
            return super().format_help()
        width = max(map(len, COMMANDS))
        lines = []
        for group, entries in GROUPS.items():
            lines.append(f"{group}:")
            lines += [f"  {name:<{width}}  {line}" for name, (_, line) in entries.items()]
            lines.append("")
        groups = "\n".join(lines)
        options = super().format_help().partition("options:\n")[2]
        return f"usage: percept COMMAND ...\n\n{self.description}\n\n{groups}\noptions:\n{options}"


def build_parser(only: Collection[str] | None = None) -> argparse.ArgumentParser:
    """Build the parser of the command line.

    Parameters
    ----------
    only : collection of str, optional
        Commands that get their arguments; the others are names with a line of help.

    Returns
    -------
    argparse.ArgumentParser
    """
    parser = _Parser(
        prog="percept",
        description="Realistic performance boundaries of haptic systems, classical and Bayesian.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("-V", "--version", action="version", version=f"percept {__version__}")
    parser.add_argument("--debug", action="store_true", help="show a traceback with an error")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, (module, line) in COMMANDS.items():
        if only is not None and name not in only:
            commands.add_parser(name, help=line)
            continue
        # Only the module of the command that is typed: all of them would double the time to start.
        home = importlib.import_module(f"percept.commands.{module}")
        command: Command = getattr(home, name.upper())
        subparser = commands.add_parser(
            name,
            help=line,
            description=command.description,
            epilog=f"example:\n  {command.example}\n",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for argument in command.arguments:
            subparser.add_argument(argument.name, **argument.settings)
        subparser.set_defaults(run=command.run, parser=subparser)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and report what goes wrong.

    Parameters
    ----------
    arguments : sequence of str, optional
        The words after ``percept``; by default the process's own arguments.

    Returns
    -------
    int
        Exit code: 0 done, 1 the analysis refuses, 2 wrong usage or unreadable input, 130
        interrupted, 141 nobody reads the output any more. SIGTERM ends the process with 143.
    """
    for number, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            # The caller closed it: the next file opened would get its number, and what is printed.
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)
            setattr(sys, name, os.fdopen(number, "w", closefd=False))
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A locale without ω or × is no reason to print nothing.
        sys.stdout.reconfigure(errors="backslashreplace")
    # The matrices are a few tens wide: a second BLAS thread costs more than it brings.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Arrays need no collector: every 200,000 objects is enough, and spares a twentieth of a report.
    gc.set_threshold(200_000)
    # At its end Python would look for garbage in all libraries: a quarter of `percept validate`.
    atexit.register(gc.freeze)
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    try:
        with _tidy_at_sigterm():
            return _reported(words)
    except BrokenPipeError:
        # What is left to be written goes nowhere.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())
        return _UNREAD


@contextmanager
def _tidy_at_sigterm() -> Iterator[None]:
    """Make SIGTERM an exception, so that what is unfinished is removed."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(_TERMINATED))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _reported(words: list[str]) -> int:
    """Run a command; turn an error into a message on standard error and an exit code."""
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    # No option before the command takes a value.
    command = next((word for word in words if not word.startswith("-")), None)
    try:
        parsed = _parsed(words, command)
        # What a page names as the command that made it.
        parsed.typed = shlex.join(["percept", *words])
        code = parsed.run(parsed) or 0
        print(end="", flush=True)
        return code
    except PerceptError as error:
        if debug:
            raise
        _complain(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        next_run = "starts again from the data"
        if command in _RESUMED:
            next_run = "keeps what is finished and goes on"
        print(f"percept: interrupted. The same command {next_run}.", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        raise
    except OSError as error:
        if debug:
            raise
        message = f"cannot be read or written: {error.strerror or error}."
        if error.filename:
            message = f"{error.filename}: {message}"
        if command in _RESUMED:
            message += " What is finished is kept: run the same command again."
        _complain(message)
        return UsageError.exit_code


def _complain(message: str) -> None:
    """Print what is wrong, escaping what names in it would do to a terminal."""
    lines = f"percept: {message}".split("\n")
    print("\n".join(map(printable, lines)), file=sys.stderr)


def _parsed(words: Sequence[str], command: str | None) -> argparse.Namespace:
    """Parse the words; refuse what percept does not know, and name what is like it."""
    if command is not None and command not in COMMANDS:
        hint = "See percept --help."
        if Path(command).exists():
            hint = f"To analyse it, run percept report {shlex.quote(command)}."
        message = f"there is no command {command!r}.{did_you_mean(command, COMMANDS)}"
        raise UsageError(message, hint=hint)
    hint = f"See percept {command} --help." if command else "See percept --help."
    parser = build_parser([command] if command else [])
    # Options of percept itself, for what is typed without a command.
    parser.set_defaults(run=lambda _: parser.print_help(), parser=parser, build_parser=build_parser)
    parsed, unknown = parser.parse_known_args(words)
    for word in unknown:
        if not word.startswith("-"):
            raise UsageError("there is one argument too many.", value=word, hint=hint)
        option = word.partition("=")[0]
        options = parsed.parser._option_string_actions
        raise UsageError(f"there is no option {option}.{did_you_mean(option, options)}", hint=hint)
    return parsed
