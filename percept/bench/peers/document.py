"""The benchmark: run what is installed on every study, and write benchmark.json, figures and the page."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from percept.bench.measure import machine
from percept.bench.peers.engines import ENGINES, STUDIES, engine
from percept.bench.peers.processes import (
    COMMANDS,
    LONGEST,
    Comparison,
    Measured,
    Whole,
    comparisons,
    measure,
    whole_commands,
)
from percept.bench.peers.reference import Reference, stored_reference, stored_references
from percept.errors import RefusalError
from percept.files import FolderFiles, filled_folder, refuse_foreign
from percept.provenance import Made, made_by
from percept.report.figures.canvas import COLOURS, Drawing, legend, log_scale, panels
from percept.report.figures.output import draw_all
from percept.report.page import render_standalone
from percept.reproduce.published import dataset
from percept.results.plain import dumps, plain

SCHEMA, PAGE = "percept-benchmark-2", "index.html"
_FILES = FolderFiles(PAGE, (PAGE, "benchmark.json", "figures/time-*.svg"))
#: Errors over half-width at which times are compared.
LEVELS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_OURS, _PLAIN = "percept", "nutpie"
#: Draws per chain that samplers of this kind take where nothing else is asked for.
_USUAL_DRAWS = 1000
_RATIO = 2.0  # time goes with the error to this power, once a sampler has converged
_Times = tuple[float, float, float]  # Warm, cold and processor time, s
_EXTRA = "pip install 'percept[peers]'"


def run_benchmark(
    out: str | Path,
    *,
    command: str,
    engines: Sequence[str] = (),
    studies: Sequence[str] = (),
    seconds: float = 150.0,
    repeats: int = 5,
    quick: bool = False,
    force: bool = False,
    log: Callable[[str], None] = lambda line: None,
) -> Path:
    """Measure every installed engine on every study with a reference, and whole commands; write the page."""
    refuse_foreign(out, _FILES, force=force)
    chosen = [engine(name) for name in engines] or list(ENGINES)
    references = {name: stored_reference(name) for name in studies or stored_references()}
    left_out = {one.title: one.missing for one in chosen if one.missing}
    present = [one for one in chosen if not one.missing]
    for title, missing in left_out.items():
        log(f"{title}: left out, {', '.join(missing)} not installed; {_EXTRA}")
    if not present:
        raise RefusalError(
            "none of these engines is installed.", value=", ".join(engines), hint=_EXTRA
        )
    begun, before = time.perf_counter(), os.getloadavg()[0]
    whole: list[Whole] = []
    if repeats:
        commands = {
            name: words for name, words in COMMANDS.items() if not quick or name not in LONGEST
        }
        if importlib.util.find_spec("pymc") is None:
            del commands["import pymc"]
            left_out["import pymc"] = ("pymc",)
        log("whole commands")
        files = str(dataset("hbfd_sessions.csv")), str(dataset("hbfd.toml"))
        whole = whole_commands(*files, repeats=0 if quick else repeats, commands=commands)
    measured: list[Measured] = []
    for study, reference in references.items():
        measured += measure(present, study, reference, seconds=seconds, quick=quick, log=log)
    packages = sorted({name for one in present for name in one.packages} - {"percept"})
    document = build_document(
        measured, whole, references, left_out=left_out, made=made_by(command, packages),
        at=machine((before, os.getloadavg()[0]), time.perf_counter() - begun),
    )  # fmt: skip
    return write_benchmark(document, out, force=force)


@dataclasses.dataclass(frozen=True)
class Reached:
    """Time of one engine to one error, and how much longer that is than percept's."""

    study: str
    engine: str
    level: float  # Error over half-width
    warm: float  # s
    cold: float  # s
    processor: float  # s
    extrapolated: (
        bool  # Whether no run was as accurate: the most accurate one, at time over error squared
    )
    warm_ratio: float  # Over percept's times to the same error, as the next two; NaN without them
    cold_ratio: float
    processor_ratio: float


def reached(measured: Sequence[Measured], levels: Sequence[float] = LEVELS) -> list[Reached]:
    """Work out times to given errors, and their ratios to percept's."""
    found: dict[tuple[str, str, float], tuple[_Times, bool]] = {}
    for study, name in dict.fromkeys((one.study, one.engine) for one in measured):
        group = [one for one in measured if (one.study, one.engine) == (study, name)]
        found |= {(study, name, level): _time_to(level, group) for level in levels}
    rows = []
    for (study, name, level), (times, extrapolated) in found.items():
        ours, _ = found.get((study, _OURS, level), ((math.nan,) * 3, False))
        warm, cold, processor = (taken / own for taken, own in zip(times, ours, strict=True))
        rows.append(Reached(study, name, level, *times, extrapolated, warm, cold, processor))
    return rows


def _time_to(level: float, group: Sequence[Measured]) -> tuple[_Times, bool]:
    """Return the times to an error, and whether no run was as accurate."""
    enough = [one for one in group if one.error <= level]
    if enough:
        best, more = min(enough, key=lambda one: one.warm), 1.0
    else:
        best = min(group, key=lambda one: one.error)
        more = (best.error / level) ** _RATIO
    start = best.cold - best.warm
    return (best.warm * more, start + best.warm * more, best.processor * more), not enough


def build_document(
    measured: Sequence[Measured],
    whole: Sequence[Whole],
    references: Mapping[str, Reference],
    *,
    made: Made,
    at: Mapping[str, Any],
    left_out: Mapping[str, Sequence[str]] | None = None,
) -> dict[str, Any]:
    """Collect a run; what was left out comes with the packages it misses."""
    times, compared = reached(measured), comparisons(whole)
    aims, present = _aims(measured, times), {row.engine for row in measured}
    studies = [
        {
            "name": name, "about": STUDIES.get(name, name), "limits": one.value.size, "runs": one.runs,
            "effective": one.effective, "scatter": one.scatter,
            "relative_error": one.relative_error(one.value + one.error),
        }
        for name, one in references.items()
    ]  # fmt: skip
    document = {
        "schema": SCHEMA,
        "made": made,
        "machine": at,
        "studies": studies,
        "engines": [
            {"name": one.name, "title": one.title, "unit": one.unit}
            for one in ENGINES
            if one.name in present
        ],
        "left_out": [
            {"name": name, "missing": missing} for name, missing in (left_out or {}).items()
        ],
        "measured": measured,
        "reached": times,
        "whole": whole,
        "comparisons": compared,
        "aims": aims,
        "losses": _losses(times, aims, compared),
    }
    return dict(plain(document))


def _aims(measured: Sequence[Measured], times: Sequence[Reached]) -> list[dict[str, Any]]:
    """Compare percept and nutpie on the plain model of the first study with what percept aims at."""
    first = [one for one in measured if one.study == measured[0].study]
    theirs = [one for one in first if one.engine == _PLAIN]
    ours = [one for one in first if one.engine == _OURS]
    if not theirs or not ours:
        return []
    best = max(ours, key=lambda one: one.effective_per_second)
    # With divergences its effective draws vary many times from run to run: what users take.
    usual = min(theirs, key=lambda one: abs(one.size - _USUAL_DRAWS))
    at = next(
        row for row in times if (row.study, row.engine, row.level) == (usual.study, _PLAIN, 0.01)
    )
    draws = best.effective_per_second / usual.effective_per_second
    processor = best.effective_per_processor_second / usual.effective_per_processor_second
    of_draws = f"effective draws per second over nutpie’s, 4 × {usual.size:.0f} draws"
    of_time = "nutpie’s sampling time to an error of 1 %, over percept’s"
    names = ("what", "value", "processor", "aim")
    rows = (
        (of_draws, draws, processor, 1000.0),
        (of_time, at.warm_ratio, at.processor_ratio, 5000.0),
    )
    return [dict(zip(names, row, strict=True)) for row in rows]


def _losses(
    times: Sequence[Reached], aims: Sequence[dict[str, Any]], compared: Sequence[Comparison]
) -> list[str]:
    """Say where percept is not the fastest, and which aims and promises are not kept."""
    lines = [
        f"{row.study}: {engine(row.engine).title} reaches {row.level:.1%} {state} in {ratio:.2f}"
        f" times percept’s time{', extrapolated' if row.extrapolated else ''}."
        for row in times
        if row.engine != _OURS
        for state, ratio in (("warm", row.warm_ratio), ("cold", row.cold_ratio))
        if ratio < 1.0
    ]
    for one in aims:
        what, value, aim = one["what"], one["value"], one["aim"]
        if value < aim:
            lines.append(f"{what[0].upper()}{what[1:]}: {value:.3g}; {aim:g} is the aim.")
    return lines + [
        f"{one.command} takes {one.ratio:.2f} times the wall time and {one.processor_ratio:.2f}"
        f" times the processor time of {one.against}; {one.promised:g} is promised."
        for one in compared
        if not one.kept
    ]


_COLOURS = "bayesian", "ink", "classical", "warn", "coupled"


def write_benchmark(
    document: Mapping[str, Any], out_dir: str | Path, *, force: bool = False
) -> Path:
    """Write a benchmark's document, figures and page."""
    with filled_folder(out_dir, _FILES, force=force) as folder:
        (folder / "benchmark.json").write_text(dumps(document), encoding="utf-8")
        drawings = [_against_error(document, one) for one in document["studies"]]
        page = render_standalone(
            "percept.bench.peers",
            "benchmark.html.j2",
            draw_all(drawings, folder / "figures"),
            digits=3,
            document=document,
            made=document["made"],
            names={one["name"]: one for one in document["engines"]},
            levels=list(dict.fromkeys(row["level"] for row in document["reached"])),
            series=list(
                dict.fromkeys((row["study"], row["engine"]) for row in document["reached"])
            ),
            at={(row["study"], row["engine"], row["level"]): row for row in document["reached"]},
        )
        (folder / PAGE).write_text(page, encoding="utf-8")
    return Path(out_dir) / PAGE


def _against_error(document: Mapping[str, Any], study: Mapping[str, Any]) -> Drawing:
    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, left=18.0, bottom=30.0)
        for one, colour in zip(document["engines"], _COLOURS, strict=False):
            of = study["name"], one["name"]
            own = [row for row in document["measured"] if (row["study"], row["engine"]) == of]
            own.sort(key=lambda row: row["size"])
            errors, times = [100.0 * row["error"] for row in own], [row["warm"] for row in own]
            ax.plot(
                errors, times, color=COLOURS[colour], marker="o", markersize=3.5, label=one["title"]
            )
        log_scale(ax)
        ax.set_xlabel("error of the limits (% of half-width)")
        ax.set_ylabel("time (s)")
        ax.margins(y=0.08)
        legend(ax, ncols=2)

    return Drawing(
        f"time-{study['name']}",
        f"Run time against error, {study['name']}",
        f"{study['about']}. Median time of sampling and limits over the root mean square error of"
        " all limits; each mark is one budget, each line one engine. Left and down is better.",
        (170.0, 118.0),
        draw,
    )
