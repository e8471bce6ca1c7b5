"""The command line: parse, call, print. Each command is a module of `percept.commands`."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import select
import sys
from collections.abc import Collection, Sequence

from percept import __version__
from percept.errors import PerceptError, printable

#: Commands in the order of an analyst's work, with the line each has in the help.
COMMANDS = {
    "new": "write a commented scene file",
    "validate": "check session files",
    "report": "analyse sessions and write the report",
    "fit": "fit the model and write its intervals",
    "compare": "compare methods, or two studies, groups or devices",
    "predict": "predict an untested environment",
    "plan": "plan the number of subjects",
    "calibrate": "simulate, refit and report real coverage",
    "batch": "fit many studies, on this machine or a cluster",
    "cache": "show or clear kept posteriors",
    "sbc": "simulation-based calibration of the model and sampler",
    "simulate": "simulate sessions like a published table",
    "reproduce": "reproduce the paper, claim by claim",
    "bench": "run time against error, and digits kept",
    "doctor": "check the environment",
    "completion": "print shell completion",
}

_EXAMPLE = """example:
  percept report sessions/ --scene scene.toml --out results
"""


def build_parser(only: Collection[str] | None = None) -> argparse.ArgumentParser:
    """Build the parser; imports the command modules, which import no numerics."""
    parser = argparse.ArgumentParser(
        prog="percept",
        description="Realistic performance boundaries of haptic systems, classical and Bayesian.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"percept {__version__}")
    parser.add_argument("--debug", action="store_true", help="show a traceback with an error")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, line in COMMANDS.items():
        if only is not None and name not in only:
            commands.add_parser(name, help=line)
            continue
        module = importlib.import_module(f"percept.commands.{name}")
        command = commands.add_parser(
            name,
            help=line,
            description=module.__doc__,
            epilog=f"example:\n  {module.EXAMPLE}\n",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(command)
        # Also behind the command; without a default of its own it leaves what stood before it.
        command.add_argument(
            "--debug", action="store_true", default=argparse.SUPPRESS, help="show a traceback with an error"
        )
        command.set_defaults(run=module.run)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A locale without ω or × is no reason to print nothing.
        sys.stdout.reconfigure(errors="backslashreplace")
    words = sys.argv[1:] if arguments is None else arguments
    # The first word that names a command is the command: no option before it takes a value.
    parsed = build_parser([word for word in words if word in COMMANDS][:1]).parse_args(words)
    # The matrices are a few tens wide: a second BLAS thread costs more than it brings.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        code = int(parsed.run(parsed))
        sys.stdout.flush()
        return code
    except PerceptError as error:
        if parsed.debug:
            raise
        _complain(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        print("percept: interrupted.", file=sys.stderr)
        return 130
    except OSError as error:
        if isinstance(error, BrokenPipeError) and _output_is_closed():
            return 141
        if parsed.debug:
            raise
        place = f"{error.filename}: " if error.filename else ""
        _complain(f"{place}{error.strerror or error}.")
        return 2


def _complain(message: str) -> None:
    """Print what is wrong; of names in it nothing reaches the terminal that would do more than be seen."""
    lines = f"percept: {message}".split("\n")
    print("\n".join(printable(line) for line in lines), file=sys.stderr)


def _output_is_closed() -> bool:
    """Say whether nobody reads standard output any more; what is left of it then goes nowhere."""
    try:
        output = sys.stdout.fileno()
        waiting = select.poll()
    except (AttributeError, OSError):
        # Standard output is no file, or a system that cannot tell.
        return False
    waiting.register(output, 0)
    closed = any(event & select.POLLERR for _, event in waiting.poll(0))
    if closed:
        os.dup2(os.open(os.devnull, os.O_WRONLY), output)
    return closed
