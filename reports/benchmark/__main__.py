"""`python -m reports.benchmark`: what percept costs and how many digits it keeps, here."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from reports.benchmark import designs, peers
from reports.benchmark.commands import command_costs
from reports.benchmark.digits import density_digits, moment_digits
from reports.benchmark.digits_haptics import haptics_digits
from reports.benchmark.measure import measurement, write_measurement
from reports.benchmark.skipping import skipping_cost
from reports.command import run, say

_PARTS = ("designs", "digits", "skipping", "peers", "commands")


def main(words: Sequence[str] | None = None) -> int:
    """Measure one part, write its page and print the page's path."""
    parser = argparse.ArgumentParser("python -m reports.benchmark", description=__doc__)
    parser.add_argument("part", choices=_PARTS, help="what to measure")
    parser.add_argument("--out", type=Path, required=True, help="folder of PART.json and PART.md")
    parser.add_argument("--cases", type=int, default=2000, help="haptics cases of digits (2000)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3], help="of designs")
    parser.add_argument("--no-peer", action="store_true", help="designs without nutpie")
    parser.add_argument("--rows", nargs="+", default=(), help="designs, or studies of peers (all)")
    parser.add_argument("--engines", nargs="+", default=(), help="of peers, only these")
    parser.add_argument("--seconds", type=float, default=150.0, help="when peers begin no new run")
    parser.add_argument("--repeats", type=int, default=7, help="rounds of commands (7)")
    return run(parser, _run, words)


def _run(arguments: argparse.Namespace) -> None:
    """Measure a part and write it."""
    part = arguments.part
    say(f"measuring {part}")
    started = time.perf_counter()
    load_before = os.getloadavg()[0]
    rows, notes = _rows(arguments)
    document = measurement(
        part,
        rows,
        command=arguments.typed,
        loads=(load_before, os.getloadavg()[0]),
        seconds=time.perf_counter() - started,
        notes=notes,
    )
    write_measurement(document, arguments.out)


def _rows(arguments: argparse.Namespace) -> tuple[Sequence[Any], Sequence[str]]:
    """Return the records of a part, and what follows from all of them."""
    out = arguments.out
    if arguments.part == "designs":
        peer = not arguments.no_peer
        costs = designs.design_costs(arguments.rows, seeds=arguments.seeds, peer=peer, out=out)
        return costs, designs.summary(costs)
    if arguments.part == "peers":
        of_peers = peers.peer_costs(
            out, engines=arguments.engines, studies=arguments.rows, seconds=arguments.seconds
        )
        return of_peers, peers.summary(of_peers)
    if arguments.part == "commands":
        return command_costs(arguments.repeats), ()
    if arguments.part == "digits":
        return [*moment_digits(), *density_digits(), *haptics_digits(arguments.cases)], ()
    return skipping_cost(), ()


if __name__ == "__main__":
    sys.exit(main())
