"""`percept doctor`, `cache` and `completion`: the installation, what it keeps, and the shell."""

from __future__ import annotations

import argparse
import platform
import re
from importlib import metadata

from percept import __version__
from percept.commands import Command, argument
from percept.errors import UsageError, counted

_CACHE = """Show what posteriors are kept for next time, or clear them.

PERCEPT_CACHE names another folder, or turns the cache off with the word "off". Beyond a gigabyte the
posteriors not used for longest go.
"""


def _doctor(_: argparse.Namespace) -> int:
    """Print the environment; 1 where a dependency that is always needed is missing or of another version."""
    from packaging.requirements import Requirement

    from percept.cache import cache_folder

    needed, broken, extras = 0, list[str](), dict[str, list[str]]()
    for requirement in map(Requirement, metadata.requires("percept") or ()):
        try:
            fits = requirement.specifier.contains(
                metadata.version(requirement.name), prereleases=True
            )
        except metadata.PackageNotFoundError:
            fits = False
        extra = re.search(r"extra == .([\w-]+)", str(requirement.marker or ""))
        lacking = extras.setdefault(extra[1], []) if extra else broken
        needed += extra is None
        if not fits:
            lacking.append(f"{requirement.name}{requirement.specifier}")
    print(f"percept {__version__}, Python {platform.python_version()}, {platform.platform()}")
    print(f"needed: {needed - len(broken)} of {needed} packages are here")
    said = [f"{name} lacks {', '.join(lacks)}" if lacks else name for name, lacks in extras.items()]
    print(f"extras: {'; '.join(said)}")
    print(f"cache: {cache_folder() or 'off'}")
    for wanted in broken:
        print(f'Install {wanted}: python -m pip install "{wanted}"')
    if not broken:
        print("Everything percept needs is here.")
    return int(bool(broken))


def _cache(arguments: argparse.Namespace) -> None:
    """Print the folder, how many posteriors it keeps and their size, or clear it."""
    from percept.cache import PosteriorCache, cache_folder

    folder = cache_folder()
    if folder is None:
        hint = "Unset it, or let it name a folder."
        raise UsageError("the cache is turned off.", key="PERCEPT_CACHE", value="off", hint=hint)
    if folder.exists() and not folder.is_dir():
        hint = "Let PERCEPT_CACHE name another."
        raise UsageError(
            "a folder is needed here, and this is a file.", file=str(folder), hint=hint
        )
    cache = PosteriorCache(folder)
    if arguments.action == "clear":
        print(f"{folder}: {counted(cache.clear(), 'posterior')} removed")
        return
    entries = cache.entries()
    megabytes = sum(entries.values()) / 1e6
    print(
        f"{folder}: {counted(len(entries), 'posterior')}, {megabytes:.1f} of"
        f" {cache.limit / 1e6:.0f} MB"
    )


def _completion(arguments: argparse.Namespace) -> None:
    """Print the script; files are completed wherever a command takes paths."""
    import shtab

    parser = arguments.build_parser()
    (commands,) = (action for action in parser._actions if action.dest == "command")
    assert isinstance(commands.choices, dict)
    offered = {"PATH": shtab.FILE, "FILE": shtab.FILE, "DIR": shtab.DIRECTORY}
    for command in commands.choices.values():
        for action in command._actions:
            if action.metavar in offered:
                action.complete = offered[action.metavar]
    print(shtab.complete(parser, shell=arguments.shell))


DOCTOR = Command(
    "Say what percept runs on: Python, its dependencies and their versions, and the cache.",
    "percept doctor",
    (),
    _doctor,
)
CACHE = Command(
    _CACHE,
    "percept cache clear",
    (
        argument(
            "action",
            None,
            "what to do (show)",
            nargs="?",
            choices=("show", "clear"),
            default="show",
        ),
    ),
    _cache,
)
COMPLETION = Command(
    "Print a completion script for a shell, to be evaluated or saved where the shell looks for it.",
    """eval "$(percept completion bash)"                         # bash, in ~/.bashrc
  eval "$(percept completion zsh)"                          # zsh, in ~/.zshrc after compinit
  percept completion tcsh > ~/.percept.csh                  # tcsh, then source it in ~/.tcshrc""",
    (argument("shell", None, "for which shell", choices=("bash", "zsh", "tcsh")),),
    _completion,
)
