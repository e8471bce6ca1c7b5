"""Pages opened in a headless Chromium by Playwright."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find_browser() -> str | None:
    """Path of a Chromium: that of PERCEPT_BROWSER, or the first on the path."""
    named = os.environ.get("PERCEPT_BROWSER")
    found = map(shutil.which, [named] if named else _NAMES)
    return next(filter(None, found), None)


@contextlib.contextmanager
def running(executable: str) -> Iterator[Any]:
    """Run one Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable)
        yield browser
        browser.close()


class Tab:
    """A page opened at a size, scheme and medium, and what the console and the network said."""

    def __init__(
        self,
        browser: Any,
        file: Path,
        *,
        width: int = 1440,
        dark: bool = False,
        scripts: bool = True,
        medium: str = "screen",
    ) -> None:
        self.complaints: list[str] = []
        self.page = browser.new_page(
            viewport={"width": width, "height": 900},
            is_mobile=width < 600,
            color_scheme="dark" if dark else "light",
            java_script_enabled=scripts,
        )
        self.page.emulate_media(media=medium)
        self.page.on("console", self._console)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", self._request)
        self.page.goto(file.resolve().as_uri())

    def _console(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)

    def _request(self, request: Any) -> None:
        if not request.url.startswith(("file:", "data:", "about:")):
            self.complaints.append(f"request to {request.url}")

    def evaluate(self, expression: str) -> Any:
        """Value of a JavaScript expression, awaited where it is a promise."""
        return self.page.evaluate(expression)

    def screenshot(self, path: Path, *, height: int | None = None) -> None:
        """Write a PNG of the page from its top, whole or to a height."""
        width = self.page.viewport_size["width"]
        clip = {"x": 0, "y": 0, "width": width, "height": height} if height else None
        self.page.screenshot(path=path, full_page=True, clip=clip)
