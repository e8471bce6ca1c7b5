"""`percept new`, `validate`, `simulate` and `reproduce`: scenes, session files, and the published study."""

from __future__ import annotations

import argparse
from importlib import resources
from pathlib import Path

from percept.commands import Command
from percept.commands.analysis import Working, in_words_of, read_scene
from percept.errors import UsageError


def _add_validate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sessions", nargs="+", metavar="PATH", help="session files or folders")
    parser.add_argument(
        "--scene", metavar="FILE", help="TOML file with [columns], [sessions], [environments]"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def _validate(arguments: argparse.Namespace) -> int:
    """Validate; the exit code is 0 without problems, otherwise the problems' own."""
    from percept.sessions import format_validation, validate

    scene, options = read_scene(arguments)
    found = validate(*arguments.sessions, options=options)
    print(found.to_json() if arguments.json else format_validation(found, say=in_words_of(scene)))
    return found.exit_code


def _add_new(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "path", nargs="?", default="scene.toml", metavar="FILE", help="file to write (scene.toml)"
    )


def _new(arguments: argparse.Namespace) -> None:
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


def _add_reproduce(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", default="reproduction", metavar="DIR", help="folder to write (reproduction)")
    parser.add_argument("--table", metavar="FILE", help="published limits (the paper's Table 1)")
    parser.add_argument("--scene", metavar="FILE", help="device, coupling and range (the paper's, with them)")
    parser.add_argument("--json", action="store_true", help="print the claims as JSON")
    parser.add_argument("--quiet", action="store_true", help="print the page's path only")


def _reproduce(arguments: argparse.Namespace) -> None:
    """Write the reproduction, and print every verdict and the page's path."""
    from percept.reproduce import load_published, write_reproduction
    from percept.reproduce.write import PAGE

    published = load_published(arguments.table, arguments.scene)
    with Working("judging the claims", shown=not arguments.quiet):
        claims = write_reproduction(published, arguments.out, command=arguments.typed)
    if arguments.json:
        print(Path(arguments.out, "claims.json").read_text(encoding="utf-8"))
        return
    if not arguments.quiet:
        for claim in claims:
            print(f"{claim.verdict:<18}“{claim.quote}”")
    print(Path(arguments.out, PAGE))


def _add_simulate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--like", required=True, metavar="FILE", help="published limits to reproduce")
    parser.add_argument("--scene", metavar="FILE", help="TOML file with [columns], [sessions] for that file")
    parser.add_argument("--seed", type=int, required=True, metavar="N", help="seed of the simulation")
    parser.add_argument("--subjects", type=int, metavar="N", help="subjects (the table's own n)")
    parser.add_argument("--out", required=True, metavar="FILE", help="CSV file to write")


def _simulate(arguments: argparse.Namespace) -> None:
    """Simulate and write; prints the path."""
    from percept.sessions import read_sessions
    from percept.simulate.like import simulate_like, write_sessions

    _, options = read_scene(arguments)
    with Working("simulating", shown=True):
        published = read_sessions(arguments.like, options=options)
        table = simulate_like(published, seed=arguments.seed, subjects=arguments.subjects)
        path = write_sessions(table, arguments.out)
    print(path)


NEW = Command(
    "Write a commented scene file that has every key, to be cut down to what a study needs.",
    "percept new scene.toml",
    _add_new,
    _new,
)
VALIDATE = Command(
    "Read session files and say what was read, every notice and every problem; analyse nothing.",
    "percept validate sessions/ --scene scene.toml",
    _add_validate,
    _validate,
)
SIMULATE = Command(
    "Simulate sessions whose t-intervals print as a published table's limits.",
    "percept simulate --like datasets/hbfd_table1.csv --seed 1 --out sessions.csv",
    _add_simulate,
    _simulate,
)
REPRODUCE = Command(
    "Reproduce the paper from its published numbers: tables, figures, and every claim with its verdict.",
    "percept reproduce --out results",
    _add_reproduce,
    _reproduce,
)
