"""`percept new`, `validate` and `simulate`."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from pathlib import Path

from percept.commands import JSON, Command, argument, number
from percept.commands.analysis import SESSIONS, Working, read_scene
from percept.errors import UsageError, counted
from percept.files import write_whole


def _validate(arguments: argparse.Namespace) -> int:
    """Validate; the exit code is 0 without problems, otherwise the problems' own."""
    from percept.sessions import format_validation, validate

    _, options = read_scene(arguments)
    found = validate(*arguments.sessions, options=options)
    if arguments.json:
        print(json.dumps(found.to_dict(), ensure_ascii=False, indent=2, default=str))
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
    from percept.sessions import read_sessions
    from percept.simulate.like import simulate_like, write_sessions

    _, options = read_scene(arguments)
    with Working("simulating", shown=True):
        published = read_sessions(arguments.like, scene=options)
        table = simulate_like(published, seed=arguments.seed, subjects=arguments.subjects)
        path = write_sessions(table, arguments.out)
    print(path)


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
