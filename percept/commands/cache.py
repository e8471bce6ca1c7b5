"""Show what posteriors are kept for next time, or clear them.

PERCEPT_CACHE names another folder, or turns the cache off with the word "off". PERCEPT_CACHE_LIMIT is how
many megabytes it may take (1000); the posteriors not used for longest go first.
"""

from __future__ import annotations

import argparse

EXAMPLE = "percept cache clear"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "action", nargs="?", choices=("show", "clear"), default="show", help="what to do (show)"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the folder, its size and entries, or clear it."""
    import json

    from percept.cache import PosteriorCache, cache_folder
    from percept.errors import UsageError

    folder = cache_folder()
    if folder is None:
        raise UsageError(
            "the cache is turned off.",
            key="PERCEPT_CACHE",
            value="off",
            hint="Unset it, or let it name a folder.",
        )
    if folder.exists() and not folder.is_dir():
        raise UsageError(
            "a folder is needed here, and this is a file.",
            file=str(folder),
            hint="Let PERCEPT_CACHE name another.",
        )
    cache = PosteriorCache(folder)
    if arguments.action == "clear":
        removed = cache.clear()
        if arguments.json:
            print(json.dumps({"folder": str(folder), "removed": removed}))
        else:
            print(f"{folder}: {removed} posteriors removed")
        return 0
    entries = cache.entries()
    total = sum(entry.size for entry in entries)
    if arguments.json:
        listed = [{"key": entry.key, "bytes": entry.size, "used_ns": entry.used} for entry in entries]
        print(
            json.dumps(
                {"folder": str(folder), "bytes": total, "limit": cache.limit, "entries": listed}, indent=1
            )
        )
        return 0
    print(f"{folder}: {len(entries)} posteriors, {total / 1e6:.1f} of {cache.limit / 1e6:.0f} MB")
    for entry in reversed(entries):
        print(f"  {entry.key[:16]}  {entry.size / 1e6:8.1f} MB  last used {_when(entry.used)}")
    return 0


def _when(nanoseconds: int) -> str:
    import datetime

    return datetime.datetime.fromtimestamp(nanoseconds / 1e9).isoformat(" ", "minutes")
