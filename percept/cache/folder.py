"""Where cached posteriors live on this machine."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from percept.errors import UsageError

#: Bytes the cache may take where PERCEPT_CACHE_LIMIT does not say otherwise.
_DEFAULT_LIMIT = 1_000_000_000


def cache_folder() -> Path | None:
    """Return the folder: PERCEPT_CACHE where it is set, else ``percept`` in the user's cache folder.

    Returns
    -------
    Path or None
        None where PERCEPT_CACHE is "off".
    """
    named = os.environ.get("PERCEPT_CACHE")
    if named == "off":
        return None
    if named:
        return Path(named).expanduser()
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or "~/AppData/Local"
    elif sys.platform == "darwin":
        base = "~/Library/Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "percept"


def cache_limit() -> int:
    """Return how many bytes the cache may take: PERCEPT_CACHE_LIMIT, in megabytes, or a gigabyte.

    Raises
    ------
    UsageError
        Where the variable is not a number above zero.
    """
    text = os.environ.get("PERCEPT_CACHE_LIMIT")
    if not text:
        return _DEFAULT_LIMIT
    try:
        megabytes = float(text)
    except ValueError:
        megabytes = 0.0
    if not 0.0 < megabytes < 1e12:
        raise UsageError(
            "must be a number of megabytes above zero.",
            key="PERCEPT_CACHE_LIMIT",
            value=text,
            hint="Use --no-cache to do without the cache.",
        )
    return int(megabytes * 1e6)
