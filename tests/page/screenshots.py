"""Screenshots of the example page, as readers see it in wide and narrow windows.

python -m tests.page.screenshots
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from PIL import Image

from tests.page.browser import Tab, find_browser, running

EXAMPLE = Path(__file__).parents[2] / "reports" / "example"
#: CSS pixels of a desktop's window and of a phone's.
WIDTHS = {"wide": 1440, "narrow": 390}
HEIGHT = 5000
#: Colours that are left: the page has few, and four pictures stay below a megabyte.
COLOURS = 48


def main():
    """Replace the pictures beside the example page; without a Chromium leave them."""
    executable = find_browser()
    if executable is None:
        print("There is no Chromium: the screenshots stay as they are.")
        return
    with running(executable) as browser, tempfile.TemporaryDirectory() as folder:
        taken = Path(folder) / "taken.png"
        for window, width in WIDTHS.items():
            for dark in (False, True):
                tab = Tab(browser, EXAMPLE / "report.html", width=width, dark=dark)
                tab.screenshot(taken, height=HEIGHT)
                tab.page.close()
                with Image.open(taken) as picture:
                    few = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
                few.save(EXAMPLE / f"{window}{'-dark' * dark}.png", optimize=True)


if __name__ == "__main__":
    main()
