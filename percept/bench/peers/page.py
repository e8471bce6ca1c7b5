"""The benchmark as one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.rendering import Plate
from percept.report.standalone import render_standalone

_SECTIONS = (
    ("result", "Result"),
    ("error", "Run time against error"),
    ("ratios", "Time to a given error"),
    ("measured", "Everything measured"),
    ("whole", "Whole commands"),
    ("growth", "Growth"),
    ("reference", "What errors are measured against"),
    ("machine", "Machine and versions"),
)


def render(document: Mapping[str, Any], plates: Mapping[str, Plate], *, date: str) -> str:
    """Render the page."""
    return render_standalone(
        "percept.bench.peers",
        "benchmark.html.j2",
        plates,
        digits=3,
        document=document,
        names={one["name"]: one for one in document["engines"]},
        levels=list(dict.fromkeys(row["level"] for row in document["reached"])),
        series=list(dict.fromkeys((row["engine"], row["how"]) for row in document["reached"])),
        at={(row["engine"], row["how"], row["level"]): row for row in document["reached"]},
        sections=_SECTIONS,
        date=date,
    )
