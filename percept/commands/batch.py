"""Fit many studies on the cores of this machine or on a dask cluster; one bad study is reported, not fatal.

Each STUDY is a session file or a folder of them (with a scene.toml of its own where it differs); of a quoted
pattern each match is one. DIR/batch.parquet has the intervals of all; an interrupted batch goes on when
started again. Exit code 1: some study was refused or its Bayesian numbers withheld, now or in an earlier run,
or failed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from percept.commands.analysis import Counting, add_setting_arguments, add_worker_arguments, settings

if TYPE_CHECKING:
    from percept.batch import Summary

EXAMPLE = "percept batch studies/* --scene scene.toml --workers 8 --out results"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "studies", nargs="*", metavar="STUDY", help="a session file, folder or quoted pattern"
    )
    parser.add_argument("--from", dest="listed", metavar="FILE", help="a text file with one STUDY per line")
    add_setting_arguments(parser)
    add_worker_arguments(parser)
    parser.add_argument("--out", default="batch", metavar="DIR", help="folder to write into (batch)")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Analyse the studies and print what became of them."""
    import json

    from percept.errors import UsageError

    try:
        from percept.batch import run_batch, sources
    except ImportError as error:
        raise UsageError(
            f"{error.name} is not installed.", hint="Install percept with its extra: percept[cluster]."
        ) from None
    from percept.report.plain import plain
    from percept.scene import Scene
    from percept.workers import open_mapper

    scene = Scene.load(arguments.scene) if arguments.scene else Scene()
    changes = settings(arguments)
    scene.with_inference(**changes)  # a wrong setting is wrong once, not once per study
    studies = sources(_named(arguments), scene=scene, changes=changes)
    with open_mapper(arguments.workers, arguments.scheduler) as mapper:
        count = Counting("studies", shown=not arguments.quiet)

        def told(done: int, total: int, bad: int) -> None:
            count(done, total, f"{bad} refused or failed")

        summary = run_batch(studies, arguments.out, mapper, progress=told)
    if arguments.json:
        print(json.dumps(plain({**vars(summary), "table": str(summary.table)}), indent=1))
    else:
        _print(summary)
    return int(bool(summary.failures))


def _named(arguments: argparse.Namespace) -> list[str]:
    from percept.errors import UsageError

    if not arguments.listed:
        return list(arguments.studies)
    try:
        lines = Path(arguments.listed).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UsageError(f"cannot be read: {reason}.", file=arguments.listed) from error
    return [*arguments.studies, *(line.strip() for line in lines if line.strip())]


def _print(summary: Summary) -> None:
    from percept.errors import counted, printable

    analysed = summary.studies - summary.skipped
    for name, message in (*summary.failures, *summary.inaccurate):
        print(printable(message if message.startswith(name) else f"{name}: {message}"), file=sys.stderr)
    words = ", ".join(f"{count} {status}" for status, count in sorted(summary.counts.items()))
    studies = counted(summary.studies, "study", "studies")
    print(f"{studies} ({words}): {summary.skipped} finished before, {analysed} now")
    if analysed:
        print(f"{summary.seconds / analysed:.2f} s of a worker per study")
    print(summary.table)
