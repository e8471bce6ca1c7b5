"""Records as a notebook shows them, and pages printed by the machine's Chromium; standard library only."""

from __future__ import annotations

import dataclasses
import html
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from percept.errors import UsageError

#: Longer sequences are told by their shape or length.
_MOST = 6
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
_PATIENCE = 120.0  # seconds for one page


class NotebookRecord:
    """Gives a dataclass `_repr_html_`: its fields, and a sentence of its own as the caption."""

    def _repr_html_(self) -> str:
        names = [field.name for field in dataclasses.fields(self)]  # type: ignore[arg-type]  # always one
        caption = next(
            (str(said) for name in ("covers", "sentence") if (said := getattr(self, name, None))), ""
        )
        return fields_html({name: getattr(self, name) for name in names}, caption=caption)


def fields_html(values: Mapping[str, Any], *, caption: str = "") -> str:
    """Lay named values out as a table."""
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{_html(value)}</td></tr>" for name, value in values.items()
    )
    above = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f"<table>{above}{rows}</table>"


def _html(value: object) -> str:
    # A table gives None where the notebook is set to show tables as text.
    shown = value._repr_html_() if hasattr(value, "_repr_html_") else None
    return html.escape(_brief(value)) if shown is None else str(shown)


def _brief(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool | str):
        return str(value)
    if dataclasses.is_dataclass(value):
        named = (f"{field.name} {_brief(getattr(value, field.name))}" for field in dataclasses.fields(value))
        return f"{type(value).__name__}: {', '.join(named)}"
    shape = getattr(value, "shape", ())
    if isinstance(shape, tuple) and shape and (len(shape) > 1 or shape[0] > _MOST):
        return f"array of shape {' × '.join(str(length) for length in shape)}"
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_brief(one)}" for key, one in value.items())
    if isinstance(value, Iterable) and not isinstance(value, str):
        parts = list(value)
        return ", ".join(_brief(one) for one in parts) if len(parts) <= _MOST else f"{len(parts)} values"
    return str(value)


def find_browser() -> str | None:
    """Return the path of a Chromium, None where there is none."""
    named = os.environ.get("PERCEPT_BROWSER")
    return next((path for name in ([named] if named else _BROWSERS) if (path := shutil.which(name))), None)


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
