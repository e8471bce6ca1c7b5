"""The page as a PDF, printed by a Chromium of the machine."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path

from percept.browser import find_browser
from percept.errors import UsageError

_PATIENCE = 120.0


def needed_browser() -> str:
    """Return the path of a Chromium, or raise UsageError where there is none."""
    browser = find_browser()
    if browser is None:
        raise UsageError(
            "report.pdf needs a Chromium, and none was found.",
            hint="Install one (Debian: apt-get install chromium), name it in PERCEPT_BROWSER, or print "
            "report.html from any browser.",
        )
    return browser


def print_pdf(page: Path, target: Path) -> None:
    """Print a page to a PDF, fonts embedded."""
    browser = needed_browser()
    with tempfile.TemporaryDirectory(prefix="percept-pdf-") as profile:
        command = [
            browser,
            "--headless",
            "--disable-gpu",
            "--disable-quic",
            "--disable-sync",
            "--disable-background-networking",
            "--disable-component-update",
            "--no-first-run",
            "--no-pdf-header-footer",
            f"--user-data-dir={profile}",
            f"--print-to-pdf={target.resolve()}",
        ]
        # Chromium's sandbox refuses to run as root.
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")
        try:
            ran = subprocess.run(
                [*command, page.resolve().as_uri()],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                check=False,
                timeout=_PATIENCE,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise UsageError(f"report.pdf could not be printed: {error}.", file=browser) from error
    if ran.returncode or not target.exists():
        raise UsageError(
            f"report.pdf could not be printed (exit code {ran.returncode}).",
            file=browser,
            hint="Print report.html from any browser instead.",
        )
