"""Figures of the benchmark: run time against error, warm and cold, and start-up times."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.figures.canvas import COLOURS, Axes, Drawing, Figure, legend_below, panels

_COLOURS = {
    "percept": "bayesian", "percept-stretch": "warn", "emcee": "ink", "nutpie": "classical",
    "nutpie-noncentred": "classical", "pymc": "coupled", "numpyro": "quiet", "numpyro-noncentred": "quiet",
}  # fmt: skip
_MARKERS = {"mixture": "o", "draws": "D"}


def drawings(document: Mapping[str, Any]) -> list[Drawing]:
    """Return the benchmark's figures, not yet drawn."""
    return [_against_error(document, state) for state in ("warm", "cold")]


def _against_error(document: Mapping[str, Any], state: str) -> Drawing:
    what = {"warm": "sampling and limits only", "cold": "with the start of the process"}[state]

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, left=18.0, bottom=38.0)
        _curves(ax, document, state)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlabel("error of the limits (% of half-width)")
        ax.set_ylabel("time (s)")
        ax.margins(y=0.08)
        legend_below(ax, columns=2)

    return Drawing(
        f"time-{state}",
        f"Run time against error, {state}",
        f"Median time ({what}) over the root mean square error of all limits; each mark is one budget, each "
        "line one engine. Left and down is better.",
        (170.0, 118.0),
        draw,
    )


def _curves(ax: Axes, document: Mapping[str, Any], state: str) -> None:
    titles = {one["name"]: one["title"] for one in document["engines"]}
    rows = document["measured"]
    for name, how in dict.fromkeys((row["engine"], row["how"]) for row in rows):
        own = sorted(
            (row for row in rows if (row["engine"], row["how"]) == (name, how)), key=lambda row: row["size"]
        )
        label = titles[name] + (f", {how}" if name == "percept" else "")
        ax.plot(
            [100.0 * row["error"] for row in own],
            [row[state] for row in own],
            color=COLOURS[_COLOURS[name]],
            linestyle="--" if "noncentred" in name or (name, how) == ("percept", "draws") else "-",
            marker=_MARKERS[how],
            markersize=3.5,
            label=label,
        )
