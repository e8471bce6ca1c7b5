"""Write a benchmark: benchmark.json, figures and the page."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from percept.bench.peers.figures import drawings
from percept.bench.peers.page import render
from percept.report.folder import filled_folder
from percept.report.plain import dumps
from percept.report.plates import draw_plates

PAGE = "index.html"


def write_benchmark(document: Mapping[str, Any], out_dir: str | Path, *, date: str | None = None) -> Path:
    """Write a benchmark's document, figures and page."""
    with filled_folder(out_dir, last=PAGE) as folder:
        (folder / "benchmark.json").write_text(dumps(document), encoding="utf-8")
        plates = draw_plates(drawings(document), folder / "figures")
        page = render(document, plates, date=date or datetime.date.today().isoformat())
        (folder / PAGE).write_text(page, encoding="utf-8")
    return Path(out_dir) / PAGE
