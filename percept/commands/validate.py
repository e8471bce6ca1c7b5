"""Read session files and say what was read, every notice and every problem; analyse nothing."""

from __future__ import annotations

import argparse
from importlib import resources
from pathlib import Path

from percept.commands import Command
from percept.errors import UsageError

EXAMPLE = "percept validate sessions/ --scene scene.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("sessions", nargs="+", metavar="PATH", help="session files or folders")
    parser.add_argument(
        "--scene", metavar="FILE", help="TOML file with [columns], [sessions], [environments]"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")
    parser.add_argument(
        "--write-map", action="store_true", help="propose a [columns] table for a file that is not understood"
    )


def run(arguments: argparse.Namespace) -> int:
    """Validate; the exit code is 0 without problems, otherwise the problems' own."""
    from percept.scene import Scene
    from percept.sessions import ReadOptions, format_validation, propose_columns, validate

    scene = Scene.load(arguments.scene) if arguments.scene else Scene()
    options = ReadOptions.from_mapping(dict(scene), file=arguments.scene)
    if arguments.write_map:
        if len(arguments.sessions) > 1:
            raise UsageError("--write-map takes one file.", value=arguments.sessions[1])
        print(propose_columns(arguments.sessions[0], options=options).text, end="")
        return 0
    found = validate(*arguments.sessions, options=options)
    print(found.to_json() if arguments.json else format_validation(found))
    return found.exit_code


def _add_path(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "path", nargs="?", default="scene.toml", metavar="FILE", help="file to write (scene.toml)"
    )


def _new(arguments: argparse.Namespace) -> int:
    """Write the file and print its path; a file that is there stays as it is."""
    path = Path(arguments.path)
    try:
        with path.open("x", encoding="utf-8", newline="\n") as file:
            file.write(resources.files("percept.commands").joinpath("scene.toml").read_text(encoding="utf-8"))
    except FileExistsError as error:
        hint = "Give another name, or remove it first."
        raise UsageError("is already there and stays as it is.", file=str(path), hint=hint) from error
    except OSError as error:
        hint = "Name a folder that is there."
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(path), hint=hint) from error
    print(path)
    return 0


NEW = Command(
    "Write a commented scene file that has every key, to be cut down to what a study needs.",
    "percept new scene.toml",
    _add_path,
    _new,
)
