"""Finished work of the pages, one line of JSON each: an interrupted run goes on from there."""

from __future__ import annotations

from pathlib import Path

from percept.checkpoint import Checkpoint

#: Beside the page that is made of it.
FILE = "finished.jsonl"


def store(folder: Path | None, plan: str) -> Checkpoint:
    """Return what the folder of a page keeps of a plan; without a folder nothing is kept."""
    path = folder / FILE if folder else None
    return Checkpoint(path, plan, what="finished")
