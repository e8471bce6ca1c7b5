"""Write a commented scene file that has every key, to be cut down to what a study needs."""

from __future__ import annotations

import argparse
from importlib import resources
from pathlib import Path

from percept.errors import UsageError

EXAMPLE = "percept new scene.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "path", nargs="?", default="scene.toml", metavar="FILE", help="file to write (scene.toml)"
    )


def run(arguments: argparse.Namespace) -> int:
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
