"""Simulate sessions whose t-intervals print as a published table's limits."""

from __future__ import annotations

import argparse

from percept.commands.analysis import Working

EXAMPLE = "percept simulate --like datasets/hbfd_table1.csv --seed 1 --out sessions.csv"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--like", required=True, metavar="FILE", help="published limits to reproduce")
    parser.add_argument("--scene", metavar="FILE", help="TOML file with [columns], [sessions] for that file")
    parser.add_argument("--seed", type=int, required=True, metavar="N", help="seed of the simulation")
    parser.add_argument("--subjects", type=int, metavar="N", help="subjects (the table's own n)")
    parser.add_argument("--out", required=True, metavar="FILE", help="CSV file to write")


def run(arguments: argparse.Namespace) -> int:
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
