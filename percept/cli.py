"""The command line: parse, call, print. Each command is a module of `percept.commands`."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import shlex
import sys
from collections.abc import Collection, Sequence
from typing import NoReturn

from percept import __version__
from percept.commands import Command
from percept.errors import PerceptError, UsageError, did_you_mean, printable

#: Commands by what they are for, each with its module of `percept.commands` and its line in the
#: help.
GROUPS = {
    "analyse": {
        "report": ("fit", "analyse sessions and write the report"),
        "fit": ("fit", "fit the model and print its intervals"),
        "compare": ("compare", "compare methods, or two studies, groups or devices"),
        "predict": ("predict", "predict an untested environment"),
        "batch": ("batch", "fit many studies, on this machine or a cluster"),
    },
    "design": {
        "plan": ("design", "plan the number of subjects"),
        "calibrate": ("design", "simulate, refit and report real coverage"),
    },
    "data": {
        "new": ("data", "write a commented scene file"),
        "validate": ("data", "check session files and say what they hold"),
        "simulate": ("data", "simulate sessions like a published table"),
        "reproduce": ("data", "reproduce the paper, claim by claim"),
    },
    "maintain": {
        "doctor": ("maintain", "check the installation"),
        "cache": ("maintain", "show or clear kept posteriors"),
        "completion": ("maintain", "print shell completion"),
        "sbc": ("design", "simulation-based calibration of the model and sampler"),
        "bench": ("bench", "run time against error, and digits kept"),
    },
}
COMMANDS = {name: entry for group in GROUPS.values() for name, entry in group.items()}
#: Commands that keep what is finished when they are interrupted.
_RESUMED = ("batch", "calibrate", "sbc")

_EXAMPLE = """example:
  percept report sessions/ --scene scene.toml --out results

percept COMMAND --help says more about a command.
"""


class _Parser(argparse.ArgumentParser):
    """Tells a mistake in a line of percept's own; the help of the whole lists its commands in groups."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}. See {self.prog} --help.\n")

    def format_help(self) -> str:
        if self.prog != "percept":
            return super().format_help()
        wide = max(map(len, COMMANDS))
        groups = ""
        for group, entries in GROUPS.items():
            lines = [f"  {name:<{wide}}  {line}\n" for name, (_, line) in entries.items()]
            groups += "".join([f"{group}:\n", *lines, "\n"])
        options = super().format_help().partition("options:\n")[2]
        return f"usage: percept COMMAND ...\n\n{self.description}\n\n{groups}options:\n{options}"


def build_parser(only: Collection[str] | None = None) -> argparse.ArgumentParser:
    """Build the parser; imports the command modules, which import no numerics."""
    parser = _Parser(
        prog="percept",
        description="Realistic performance boundaries of haptic systems, classical and Bayesian.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"percept {__version__}")
    parser.add_argument("--debug", action="store_true", help="show a traceback with an error")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, (home, line) in COMMANDS.items():
        if only is not None and name not in only:
            commands.add_parser(name, help=line)
            continue
        part: Command = getattr(importlib.import_module(f"percept.commands.{home}"), name.upper())
        command = commands.add_parser(
            name,
            help=line,
            description=part.description,
            epilog=f"example:\n  {part.example}\n",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for argument in part.arguments:
            command.add_argument(argument.name, **argument.settings)
        command.set_defaults(run=part.run, parser=command)
    return parser


def _parsed(words: Sequence[str]) -> argparse.Namespace:
    """Parse the words of a command line; what percept does not know it refuses, with what is like it."""
    # The first word that is no option is the command: no option before it takes a value.
    first = next((word for word in words if not word.startswith("-")), None)
    if first is not None and first not in COMMANDS:
        hint = "See percept --help."
        raise UsageError(
            f"there is no command {first!r}.{did_you_mean(first, COMMANDS)}", hint=hint
        )
    hint = f"See percept {first} --help." if first else "See percept --help."
    parser = build_parser([first] if first else [])
    parsed, unknown = parser.parse_known_args(words)
    for word in unknown:
        if not word.startswith("-"):
            raise UsageError("there is one argument too many.", value=word, hint=hint)
        option = word.partition("=")[0]
        options = getattr(parsed, "parser", parser)._option_string_actions
        raise UsageError(f"there is no option {option}.{did_you_mean(option, options)}", hint=hint)
    return parsed


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A locale without ω or × is no reason to print nothing.
        sys.stdout.reconfigure(errors="backslashreplace")
    given = sys.argv[1:] if arguments is None else arguments
    words = [word for word in given if word != "--debug"]
    # The matrices are a few tens wide: a second BLAS thread costs more than it brings.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    debug, command = len(words) < len(given), None
    try:
        parsed = _parsed(words)
        parsed.typed = shlex.join(["percept", *words])
        command = parsed.command
        if command is None:
            build_parser(()).print_help()
            return 0
        code = parsed.run(parsed) or 0
        sys.stdout.flush()
        return code
    except PerceptError as error:
        if debug:
            raise
        _complain(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        left = (
            "keeps what is finished and goes on"
            if command in _RESUMED
            else "starts again from the data"
        )
        print(f"percept: interrupted. The same command {left}.", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # Nobody reads standard output any more; what is left of it goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        if debug:
            raise
        place = f"{error.filename}: " if error.filename else ""
        kept = (
            " What is finished is kept: run the same command again." if command in _RESUMED else ""
        )
        _complain(f"{place}cannot be read or written: {error.strerror or error}.{kept}")
        return 2


def _complain(message: str) -> None:
    """Print what is wrong; of names in it nothing reaches the terminal that would do more than be seen."""
    lines = f"percept: {message}".split("\n")
    print("\n".join(printable(line) for line in lines), file=sys.stderr)
