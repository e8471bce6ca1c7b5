"""Intervals of the adjustments against their references, both methods beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.canvas import COLOURS, Axes
from percept.report.select import KINDS, METHOD_NAMES, METHODS

_WIDTH = {"mean": 3.2, "user": 1.6, "share": 0.7}

_MARK = {"classical": "o", "bayesian": "D"}


@dataclass(frozen=True, eq=False)
class Bar:
    """An interval to draw, relative to its reference."""

    environment: str
    kind: str
    method: str
    lower: float  # Divided by the reference
    upper: float  # Divided by the reference
    estimate: float  # Divided by the reference


def draw_intervals(
    ax: Axes,
    environments: Sequence[str],
    bars: Sequence[Bar],
    values: Sequence[NDArray[np.float64]],
    *,
    log: bool,
    labels: Sequence[str] | None = None,
) -> None:
    """Draw a group of bars per environment: kinds by thickness, methods by colour and mark."""
    place = {environment: -index for index, environment in enumerate(environments)}
    present = [method for method in METHODS if any(bar.method == method for bar in bars)]
    ends = np.array([edge for bar in bars for edge in (bar.lower, bar.upper)], dtype=float)
    log = log and bool((ends > 0).any())
    ends = ends[np.isfinite(ends) & ((ends > 0) | (not log))]
    for bar in bars:
        y = place[bar.environment] + _offset(bar.kind, bar.method, present)
        low = ends.min() / 2 if log and bar.lower <= 0 else bar.lower
        ax.plot(
            [low, bar.upper],
            [y, y],
            color=COLOURS[bar.method],
            linewidth=_WIDTH[bar.kind],
            label=f"{METHOD_NAMES[bar.method]}, {bar.kind}",
        )
        if bar.kind == "mean":
            ax.plot(
                [bar.estimate],
                [y],
                marker=_MARK[bar.method],
                markersize=3.4,
                markerfacecolor=COLOURS["paper"],
                markeredgecolor=COLOURS[bar.method],
                linestyle="none",
            )
    for environment, seen in zip(environments, values, strict=True):
        ax.plot(
            seen,
            np.full(len(seen), place[environment] - 0.42),
            marker="|",
            markersize=5,
            color=COLOURS["quiet"],
            linestyle="none",
            label="one subject" if len(seen) else None,
        )
    ax.axvline(1.0, color=COLOURS["ink"], linestyle=(0, (7, 3)), linewidth=0.8)
    if log:
        ax.set_xscale("log")
        ax.set_xlim(ends.min() / 1.15, ends.max() * 1.15)
        _plain_ticks(ax)
    ax.set_yticks(list(place.values()), environments if labels is None else labels)
    ax.set_ylim(-len(environments) + 0.4, 0.6)
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)


def _offset(kind: str, method: str, present: Sequence[str]) -> float:
    step = 0.72 / (len(KINDS) * len(present))
    rank = KINDS.index(kind) * len(present) + present.index(method)
    return 0.38 - step * rank


def _plain_ticks(ax: Axes) -> None:
    low, high = ax.get_xlim()
    decades = np.log10(high / low)
    marks = np.array([1.0, 2.0, 5.0] if decades < 3 else [1.0])
    if decades < 0.7:
        marks = np.arange(1, 10, 0.5 if decades > 0.3 else 0.2)
    powers = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)))
    places = (powers[:, None] * marks).ravel()
    # Twelve at the most, or the labels touch; a range of many decades keeps every second or third.
    places = places[(places >= low) & (places <= high)]
    places = places[:: -(-len(places) // 12)] if len(places) else places
    ax.set_xticks(places.tolist(), [f"{place:g}" for place in places])
    ax.xaxis.minorticks_off()
