"""Print a completion script for a shell, to be evaluated or saved where the shell looks for it."""

from __future__ import annotations

import argparse

EXAMPLE = """eval "$(percept completion bash)"                         # bash, in ~/.bashrc
  eval "$(percept completion zsh)"                          # zsh, in ~/.zshrc after compinit
  percept completion tcsh > ~/.percept.csh                  # tcsh, then source it in ~/.tcshrc"""
_PATHS = ("PATH", "FILE", "DIR")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="for which shell")


def run(arguments: argparse.Namespace) -> int:
    """Print the script; files are completed wherever a command takes paths."""
    import shtab

    from percept.cli import build_parser

    print(shtab.complete(_with_files(build_parser()), shell=arguments.shell))
    return 0


def _with_files(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """Mark arguments that take paths, in every command, so that the shell offers files."""
    import shtab

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _with_files(command)
        elif action.metavar in _PATHS:
            action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE  # type: ignore[attr-defined]
    return parser
