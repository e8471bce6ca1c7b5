"""What a benchmark measured and what follows from it: benchmark.json, two figures and the page."""

from __future__ import annotations

import dataclasses
import datetime
import importlib.metadata
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept import __version__
from percept.bench.growth import Growth
from percept.bench.measure import machine
from percept.bench.peers.engines import ENGINES, engine
from percept.bench.peers.processes import Comparison, Measured, Startup, Whole, comparisons
from percept.bench.peers.reference import Reference
from percept.files import filled_folder
from percept.report.figures.canvas import COLOURS, Drawing, legend_below, panels
from percept.report.figures.output import draw_all
from percept.report.page import render_standalone
from percept.report.plain import dumps, plain

SCHEMA = "percept-benchmark-1"
#: Errors over half-width at which times are compared.
LEVELS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_OURS = ("percept", "mixture")
#: Draws per chain that samplers of this kind take where nothing else is asked for.
_USUAL_DRAWS = 1000
_RATIO = 2.0  # time goes with the error to this power, once a sampler has converged


@dataclasses.dataclass(frozen=True)
class Reached:
    """Time of one engine to one error, and how much longer that is than percept's."""

    engine: str
    how: str
    level: float  # Error over half-width
    warm: float  # s
    cold: float  # s
    processor: float  # s
    extrapolated: bool  # Whether no run was as accurate: the most accurate one, at time over error squared
    warm_ratio: float = math.nan  # Over percept's times to the same error
    cold_ratio: float = math.nan  # Over percept's times to the same error
    processor_ratio: float = math.nan  # Over percept's times to the same error


def reached(measured: Sequence[Measured], levels: Sequence[float] = LEVELS) -> list[Reached]:
    """Work out times to given errors, and their ratios to percept's."""
    rows = []
    for engine_, how in dict.fromkeys((one.engine, one.how) for one in measured):
        group = [one for one in measured if (one.engine, one.how) == (engine_, how)]
        rows += [_reached(group, level) for level in levels]
    ours = {row.level: row for row in rows if (row.engine, row.how) == _OURS}
    return [
        dataclasses.replace(
            row,
            warm_ratio=row.warm / ours[row.level].warm,
            cold_ratio=row.cold / ours[row.level].cold,
            processor_ratio=row.processor / ours[row.level].processor,
        )
        if row.level in ours
        else row
        for row in rows
    ]


def _reached(group: Sequence[Measured], level: float) -> Reached:
    enough = [one for one in group if one.error <= level]
    if enough:
        best, more = min(enough, key=lambda one: one.warm), 1.0
    else:
        best = min(group, key=lambda one: one.error)
        more = (best.error / level) ** _RATIO
    warm = best.warm * more
    return Reached(
        best.engine, best.how, level, warm, best.cold - best.warm + warm, best.processor * more, not enough
    )


def build_document(
    startups: Sequence[Startup],
    measured: Sequence[Measured],
    whole: Sequence[Whole],
    reference: Reference,
    *,
    growth: Sequence[Growth] = (),
    left_out: Mapping[str, Sequence[str]] | None = None,
    command: str,
    loads: tuple[float, float],
    seconds: float,
) -> dict[str, Any]:
    """Collect a run; what was left out comes with the packages it misses."""
    times = reached(measured)
    compared = comparisons(whole)
    promises = _promises(measured, times)
    engines = [one for one in ENGINES if one.name in {row.engine for row in measured}]
    packages = {name for one in engines for name in one.packages}
    # What is installed here: rows may have been measured elsewhere.
    installed = {one.name.lower(): one.version for one in importlib.metadata.distributions()}
    document = {
        "schema": SCHEMA,
        "command": command,
        "machine": machine(loads, seconds),
        "versions": {"percept": __version__}
        | {name: installed[name] for name in sorted(packages) if name in installed},
        "reference": {
            "command": reference.command, "own_effective": reference.own.effective,
            "own_runs": reference.own.runs, "own_scatter": reference.own.scatter,
            "other_effective": reference.other.effective, "other_runs": reference.other.runs,
            "other_scatter": reference.other.scatter, "worst_apart": np.abs(reference.apart).max(),
            "mean_square_apart": (reference.apart**2).mean(),
            "relative_error": np.sqrt(((reference.own.error / reference.half_width) ** 2).mean()),
        },
        "engines": [{"name": one.name, "title": one.title, "unit": one.unit} for one in engines],
        "left_out": [{"name": name, "missing": missing} for name, missing in (left_out or {}).items()],
        "startups": startups,
        "measured": measured,
        "reached": times,
        "whole": whole,
        "comparisons": compared,
        "growth": growth,
        "promises": promises,
        "losses": _losses(times, promises, compared, growth),
    }  # fmt: skip
    collected: dict[str, Any] = plain(document)
    return collected


def _promises(measured: Sequence[Measured], times: Sequence[Reached]) -> list[dict[str, Any]]:
    """Set what percept is meant to reach against nutpie on the plainly written model beside what it did."""
    nutpie = [one for one in measured if one.engine == "nutpie"]
    ours = [one for one in measured if (one.engine, one.how) == _OURS]
    if not nutpie or not ours:
        return []
    best = max(ours, key=lambda one: one.effective_per_second)
    # With divergences its effective draws vary many times from run to run: what users take, and its best.
    usual = min(nutpie, key=lambda one: abs(one.size - _USUAL_DRAWS))
    luckiest = max(nutpie, key=lambda one: one.effective_per_second)
    at = next(row for row in times if row.engine == "nutpie" and row.level == 0.01)
    steps = min(one.notes["autocorrelation_time"] for one in ours)
    return [
        *(
            {
                "what": f"effective draws per second over nutpie’s{when}",
                "value": best.effective_per_second / theirs.effective_per_second,
                "processor": best.effective_per_processor_second / theirs.effective_per_processor_second,
                "aim": 1000.0, "floor": 300.0, "more_is_better": True,
            }
            for theirs, when in (
                (usual, f", 4 × {usual.size:.0f} draws"),
                (luckiest, f" at its best, 4 × {luckiest.size:.0f} draws"),
            )
        ),
        {
            "what": "nutpie’s sampling time to an error of 1 %, over percept’s", "value": at.warm_ratio,
            "processor": at.processor_ratio, "aim": 5000.0, "floor": 1000.0, "more_is_better": True,
        },
        {
            "what": "autocorrelation time of the slowest quantity, in steps", "value": steps,
            "processor": None, "aim": 15.0, "floor": None, "more_is_better": False,
        },
    ]  # fmt: skip


def _losses(
    times: Sequence[Reached],
    promises: Sequence[dict[str, Any]],
    compared: Sequence[Comparison],
    growth: Sequence[Growth],
) -> list[str]:
    """Say where percept is not the fastest, and which promises are not kept."""
    lines = []
    for row in times:
        for state, ratio in (("warm", row.warm_ratio), ("cold", row.cold_ratio)):
            if (row.engine, row.how) != _OURS and ratio < 1.0:
                title = f"{engine(row.engine).title} ({row.how})"
                lines.append(
                    f"{title} reaches {row.level:.1%} {state} in {ratio:.2f} times percept’s time"
                    + (", extrapolated." if row.extrapolated else ".")
                )
    for promise in promises:
        what, value, aim = promise["what"], promise["value"], promise["aim"]
        if value < aim if promise["more_is_better"] else value > aim:
            lines.append(f"{what[0].upper()}{what[1:]}: {value:.3g}; {aim:g} is the aim.")
    lines += [
        f"{one.command} takes {one.ratio:.2f} times as long as {one.against}; {one.promised:g} is promised."
        for one in compared
        if not one.kept
    ]
    lines += [
        f"With {one.along} a {one.task} at {one.size} takes {one.ratio:.2f} times as long as at the least; "
        f"{one.promised:g} is promised."
        for one in growth
        if one.promised is not None and one.ratio > one.promised
    ]
    return lines


PAGE = "index.html"
_COLOURS = {
    "percept": "bayesian", "percept-stretch": "warn", "emcee": "ink", "nutpie": "classical",
    "nutpie-noncentred": "classical", "pymc": "coupled", "numpyro": "quiet", "numpyro-noncentred": "quiet",
}  # fmt: skip
_MARKERS = {"mixture": "o", "draws": "D"}
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


def write_benchmark(document: Mapping[str, Any], out_dir: str | Path, *, date: str | None = None) -> Path:
    """Write a benchmark's document, figures and page."""
    with filled_folder(out_dir, last=PAGE) as folder:
        (folder / "benchmark.json").write_text(dumps(document), encoding="utf-8")
        drawings = [_against_error(document, state) for state in ("warm", "cold")]
        page = render_standalone(
            "percept.bench.peers",
            "benchmark.html.j2",
            draw_all(drawings, folder / "figures"),
            digits=3,
            document=document,
            names={one["name"]: one for one in document["engines"]},
            levels=list(dict.fromkeys(row["level"] for row in document["reached"])),
            series=list(dict.fromkeys((row["engine"], row["how"]) for row in document["reached"])),
            at={(row["engine"], row["how"], row["level"]): row for row in document["reached"]},
            sections=_SECTIONS,
            date=date or datetime.date.today().isoformat(),
        )
        (folder / PAGE).write_text(page, encoding="utf-8")
    return Path(out_dir) / PAGE


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
    rows = sorted(document["measured"], key=lambda row: row["size"])
    for name, how in dict.fromkeys((row["engine"], row["how"]) for row in document["measured"]):
        own = [row for row in rows if (row["engine"], row["how"]) == (name, how)]
        ax.plot(
            [100.0 * row["error"] for row in own],
            [row[state] for row in own],
            color=COLOURS[_COLOURS[name]],
            linestyle="--" if "noncentred" in name or (name, how) == ("percept", "draws") else "-",
            marker=_MARKERS[how],
            markersize=3.5,
            label=titles[name] + (f", {how}" if name == "percept" else ""),
        )
