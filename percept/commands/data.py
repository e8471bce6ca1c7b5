"""`percept new`, `validate`, `simulate` and `doctor`: scenes, session files, the installation."""

from __future__ import annotations

import argparse
import os
import platform
import re
import shlex
import sys
from importlib import metadata
from pathlib import Path

from percept import __version__
from percept.commands import JSON, Command, argument, number
from percept.commands.analysis import SESSIONS, Working, print_json, read_scene
from percept.errors import UsageError, counted
from percept.files import write_whole


def _validate(arguments: argparse.Namespace) -> int:
    """Validate; the exit code is 0 without problems, otherwise the problems' own."""
    from percept.sessions import format_validation, validate

    found = validate(*arguments.sessions, scene=read_scene(arguments))
    if arguments.json:
        print_json(found.to_dict())
    else:
        print(format_validation(found))
    return found.exit_code


def _new(arguments: argparse.Namespace) -> None:
    """Write the file and print its path; a file that is there stays as it is."""
    if arguments.data is None:
        from importlib import resources

        text = resources.files("percept.commands").joinpath("scene.toml").read_text("utf-8")
        _write_new(arguments.path, text)
        print(arguments.path)
        return
    from percept.sessions import propose_scene

    scene = propose_scene(*arguments.data)
    _write_new(arguments.path, scene)
    print(scene, file=sys.stderr)
    print(arguments.path)
    to_edit = scene.count(' = "?"')
    left = f'{counted(to_edit, "line")} to edit: replace each "?".'
    command = ["percept", "report", *arguments.data, "--scene", arguments.path, "--out", "results"]
    print(
        f"percept: {left if to_edit else 'Look through it.'} Then run: {shlex.join(command)}",
        file=sys.stderr,
    )


def _write_new(path: str, text: str) -> None:
    """Write a file that is not there yet."""
    hint = "Give another name, or remove it first."
    if os.path.lexists(path):
        raise UsageError("is already there and stays as it is.", file=path, hint=hint)
    try:
        write_whole(Path(path), text.encode())
    except OSError as error:
        hint = "Name a folder that is there."
        raise UsageError(f"cannot be written: {error.strerror}.", file=path, hint=hint) from error


def _simulate(arguments: argparse.Namespace) -> None:
    """Simulate and write; prints the path."""
    from percept.published import sessions_csv, simulate_like
    from percept.sessions import read_sessions

    scene = read_scene(arguments)
    with Working("simulating", shown=True):
        published = read_sessions(arguments.like, scene=scene)
        table = simulate_like(published, seed=arguments.seed, subjects=arguments.subjects)
        _write_new(arguments.out, sessions_csv(table))
    print(arguments.out)


_READING = argument("--scene", "FILE", "TOML file with [columns], [sessions], [environments]")

NEW = Command(
    "Write a commented scene file that has every key, to be cut down to what a study needs."
    " With --from it maps the columns of your files whose names say what they are, and holds a"
    ' "?" where you must decide.',
    "percept new scene.toml --from sessions/",
    (
        argument("path", "FILE", "file to write (scene.toml)", nargs="?", default="scene.toml"),
        argument("--from", "PATH", "session files or folders to look at", nargs="+", dest="data"),
    ),
    _new,
)
VALIDATE = Command(
    "Read session files and say what was read, every notice and every problem; analyse nothing.",
    "percept validate sessions/ --scene scene.toml",
    (SESSIONS, _READING, JSON),
    _validate,
)
SIMULATE = Command(
    "Simulate sessions whose t-intervals print as a published table's limits.",
    "percept simulate --like datasets/hbfd_table1.csv --seed 1 --out sessions.csv",
    (
        argument("--like", "FILE", "published limits to reproduce", required=True),
        _READING,
        number("--seed", "N", "seed of the simulation", required=True),
        number("--subjects", "N", "subjects (the table's own n)"),
        argument("--out", "FILE", "CSV file to write", required=True),
    ),
    _simulate,
)


#: The name that pip installs percept by.
_DISTRIBUTION = "percept-haptics"
#: The name that the package index gave to another project, with a package `percept` of its own.
_STRANGER = "percept"

_DOCTOR = """Say what percept runs on: Python, its dependencies and their versions, and the cache.

PERCEPT_CACHE names another folder for the cache, or turns it off with the word "off". Beyond a
gigabyte the posteriors not used for longest go.
"""


def _doctor(arguments: argparse.Namespace) -> int:
    """Look at the cache, print shell completion, or check the installation."""
    if arguments.cache is not None:
        _cache(arguments.cache)
        return 0
    if arguments.completion is not None:
        _completion(arguments)
        return 0
    return _check_installation()


def _check_installation() -> int:
    """Print the environment; 1 where a package is missing, of another version or a stranger's."""
    from packaging.requirements import Requirement

    from percept.cache import cache_folder

    needed = 0
    broken: list[str] = []
    extras: dict[str, list[str]] = {}  # What each extra lacks
    for line in metadata.requires(_DISTRIBUTION) or ():
        requirement = Requirement(line)
        extra = re.search(r"extra == .([\w-]+)", str(requirement.marker or ""))
        if extra is None:
            needed += 1
            lacking = broken
        else:
            lacking = extras.setdefault(extra[1], [])
        version = _installed(requirement.name)
        if version is None or not requirement.specifier.contains(version, prereleases=True):
            lacking.append(f"{requirement.name}{requirement.specifier}")
    print(f"percept {__version__}, Python {platform.python_version()}, {platform.platform()}")
    print(f"needed: {needed - len(broken)} of {needed} packages are here")
    states = [
        f"{name} lacks {', '.join(lacking)}" if lacking else name
        for name, lacking in extras.items()
    ]
    print(f"extras: {'; '.join(states)}")
    print(f"cache: {cache_folder() or 'off'}")
    for package in broken:
        print(f'Install {package}: python -m pip install "{package}"')
    stranger = _installed(_STRANGER) is not None
    if stranger:
        print(
            f"Another project's package '{_STRANGER}' is installed here, and its files replace "
            f"the files of {_DISTRIBUTION}. Remove it: python -m pip uninstall {_STRANGER}. "
            f"Then run: python -m pip install --force-reinstall {_DISTRIBUTION}"
        )
    if not broken and not stranger:
        print("Everything percept needs is here.")
    return int(bool(broken) or stranger)


def _installed(distribution: str) -> str | None:
    """Return the version of a distribution of exactly this name; None where it is not here."""
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _cache(action: str) -> None:
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
    if action == "clear":
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
    print(shtab.complete(parser, shell=arguments.completion))


DOCTOR = Command(
    _DOCTOR,
    """percept doctor
  percept doctor --cache clear
  eval "$(percept doctor --completion bash)"                # bash, in ~/.bashrc
  eval "$(percept doctor --completion zsh)"                 # zsh, in ~/.zshrc after compinit
  percept doctor --completion fish > ~/.config/fish/completions/percept.fish
  percept doctor --completion tcsh > ~/.percept.csh         # tcsh, then source it in ~/.tcshrc""",
    (
        argument(
            "--cache",
            None,
            "show or clear the posteriors kept for next time",
            choices=("show", "clear"),
        ),
        argument(
            "--completion",
            None,
            "print a completion script for a shell",
            choices=("bash", "zsh", "fish", "tcsh"),
        ),
    ),
    _doctor,
)
