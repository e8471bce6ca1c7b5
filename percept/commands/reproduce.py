"""Reproduce the paper from its published numbers: tables, figures, and every claim with its verdict."""

from __future__ import annotations

import argparse

from percept.commands import Command
from percept.commands.analysis import Working

EXAMPLE = "percept reproduce --out results"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--out", default="reproduction", metavar="DIR", help="folder to write (reproduction)")
    parser.add_argument("--table", metavar="FILE", help="published limits (the paper's Table 1)")
    parser.add_argument("--scene", metavar="FILE", help="device, coupling and range (the paper's, with them)")
    parser.add_argument("--json", action="store_true", help="print the claims as JSON")
    parser.add_argument("--quiet", action="store_true", help="print the page's path only")


def run(arguments: argparse.Namespace) -> int:
    """Write the reproduction, and print every verdict and the page's path."""
    from percept.reproduce import load_published, write_reproduction

    published = load_published(arguments.table, arguments.scene)
    with Working("judging the claims", shown=not arguments.quiet):
        written = write_reproduction(published, arguments.out)
    if arguments.json:
        print((written.folder / "claims.json").read_text(encoding="utf-8"))
        return 0
    if not arguments.quiet:
        for claim in written.claims:
            print(f"{claim.verdict:<18}“{claim.quote}”")
    print(written.page)
    return 0


def _add_simulation(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--like", required=True, metavar="FILE", help="published limits to reproduce")
    parser.add_argument("--scene", metavar="FILE", help="TOML file with [columns], [sessions] for that file")
    parser.add_argument("--seed", type=int, required=True, metavar="N", help="seed of the simulation")
    parser.add_argument("--subjects", type=int, metavar="N", help="subjects (the table's own n)")
    parser.add_argument("--out", required=True, metavar="FILE", help="CSV file to write")


def _simulate(arguments: argparse.Namespace) -> int:
    """Simulate and write; prints the path."""
    from percept.scene import Scene
    from percept.sessions import ReadOptions, read_sessions
    from percept.simulate.like import simulate_like, write_sessions

    scene = Scene.load(arguments.scene) if arguments.scene else Scene()
    options = ReadOptions.from_mapping(dict(scene), file=arguments.scene)
    with Working("simulating", shown=True):
        published = read_sessions(arguments.like, options=options)
        table = simulate_like(published, seed=arguments.seed, subjects=arguments.subjects)
        path = write_sessions(table, arguments.out)
    print(path)
    return 0


SIMULATE = Command(
    "Simulate sessions whose t-intervals print as a published table's limits.",
    "percept simulate --like datasets/hbfd_table1.csv --seed 1 --out sessions.csv",
    _add_simulation,
    _simulate,
)
