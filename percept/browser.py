"""The Chromium of the machine, which prints pages; nothing but the standard library."""

from __future__ import annotations

import os
import shutil

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")


def find_browser() -> str | None:
    """Return the path of a Chromium, None where there is none."""
    named = os.environ.get("PERCEPT_BROWSER")
    return next((path for name in ([named] if named else _NAMES) if (path := shutil.which(name))), None)
