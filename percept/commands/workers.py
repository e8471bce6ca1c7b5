"""What every command with many studies shares: the arguments that say where they are worked on."""

from __future__ import annotations

import argparse


def add_worker_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--workers` and `--scheduler`, as `percept.workers.open_mapper` takes them."""
    parser.add_argument("--workers", type=int, metavar="N", help="processes on this machine (all cores)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a running dask scheduler, in their place")
