"""`percept batch`: many studies."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from percept.commands import JSON, Command, argument, folder
from percept.commands.analysis import SETTINGS, WORKERS, Working, print_json, read_scene, settings
from percept.errors import UsageError, counted, printable

if TYPE_CHECKING:
    from percept.batch import Summary

_DESCRIPTION = """Fit many studies on the cores of this machine or on a dask cluster.

Each STUDY is a session file or a folder of them (with a scene.toml of its own where it differs); of a quoted
pattern each match is one. DIR/batch.parquet has the intervals of all. A bad study stops no other, and an
interrupted batch goes on when started again. Exit code 1: some study failed, was refused or has no Bayesian
numbers.
"""


def _run(arguments: argparse.Namespace) -> int:
    """Analyse the studies and print what became of them."""
    try:
        from percept.batch import run_batch, sources
    except ImportError as error:
        raise UsageError(
            f"{error.name} is not installed.",
            hint="Install percept with its extra: percept[cluster].",
        ) from None
    from percept.workers import open_mapper

    scene, _ = read_scene(arguments)
    changes = settings(arguments)
    scene.with_inference(**changes)  # a wrong setting is wrong once, not once per study
    studies = sources(arguments.studies, scene=scene, changes=changes)
    with (
        Working("reading", shown=not arguments.quiet) as working,
        open_mapper(arguments.workers, arguments.scheduler) as mapper,
    ):

        def told(done: int, total: int, bad: int) -> None:
            working.show(f"{done} of {total} studies, {bad} refused or failed", done, total)

        summary = run_batch(studies, arguments.out, mapper, progress=told)
    if arguments.json:
        print_json({**vars(summary), "table": str(summary.table)})
    else:
        _print(summary)
    return int(bool(summary.failures))


def _print(summary: Summary) -> None:
    for name, message in (*summary.failures, *summary.inaccurate):
        print(
            printable(message if message.startswith(name) else f"{name}: {message}"),
            file=sys.stderr,
        )
    words = ", ".join(f"{count} {status}" for status, count in sorted(summary.counts.items()))
    studies = counted(summary.studies, "study", "studies")
    print(
        f"{studies} ({words}): {summary.skipped} finished before,"
        f" {summary.studies - summary.skipped} now"
    )
    print(summary.table)


BATCH = Command(
    _DESCRIPTION,
    "percept batch studies/* --scene scene.toml --workers 8 --out results",
    (
        argument("studies", "STUDY", "a session file, folder or quoted pattern", nargs="+"),
        *SETTINGS,
        *WORKERS,
        folder("batch"),
        JSON,
    ),
    _run,
)
