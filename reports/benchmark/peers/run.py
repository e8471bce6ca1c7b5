"""The benchmark: run what is installed on every study, and write document, figures and page."""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from percept.errors import RefusalError
from percept.provenance import made_by
from percept.report.figures.canvas import COLOURS, Drawing, Frame, legend, log_scale, panels
from percept.report.figures.output import draw_all
from percept.report.page import render_standalone
from percept.results.plain import dumps, plain
from reports import dataset
from reports.benchmark.measure import machine
from reports.benchmark.peers.document import Benchmark, StudyFacts, build_document
from reports.benchmark.peers.engines import ENGINES, STUDIES, engine
from reports.benchmark.peers.processes import (
    COMMANDS,
    LONGEST,
    Measured,
    Whole,
    measure,
    whole_commands,
)
from reports.benchmark.peers.reference import stored_reference
from reports.command import say, write_page

PAGE = "index.html"
_EXTRA = "pip install 'percept-haptics[peers]'"
_COLOURS = ("bayesian", "ink", "classical")


def run_benchmark(
    out: Path,
    *,
    command: str,
    engines: Sequence[str] = (),
    studies: Sequence[str] = (),
    seconds: float,
    repeats: int,
    quick: bool = False,
) -> None:
    """Measure every installed engine on every study with a reference, and whole commands.

    Parameters
    ----------
    out : Path
        Folder of the page, which keeps reference.json.
    command : str
        What was typed, as the page says it.
    engines, studies : sequence of str
        What is measured; all without names.
    seconds : float
        After which no run of an engine begins.
    repeats : int
        Rounds of whole commands.
    quick : bool
        Whether only the smallest budgets run, to see that all works.

    Raises
    ------
    RefusalError
        Where no engine asked for is installed, or a study has no reference.
    UsageError
        For an engine that does not exist.
    """
    chosen = [engine(name) for name in engines] or list(ENGINES)
    present = [sampler for sampler in chosen if not sampler.missing]
    left_out = {sampler.title: sampler.missing for sampler in chosen if sampler.missing}
    for title, missing in left_out.items():
        say(f"{title}: left out, {', '.join(missing)} not installed; {_EXTRA}")
    if not present:
        names = ", ".join(engines)
        raise RefusalError("none of these engines is installed.", value=names, hint=_EXTRA)
    references = {name: stored_reference(out, name) for name in studies or STUDIES}
    begun = time.perf_counter()
    load_before = os.getloadavg()[0]
    whole: list[Whole] = []
    if repeats:
        if importlib.util.find_spec("pymc") is None:
            left_out["import pymc"] = ("pymc",)
        say("whole commands")
        whole = _whole(0 if quick else repeats, quick=quick, without=tuple(left_out))
    measured: list[Measured] = []
    for study, reference in references.items():
        measured += measure(present, study, reference, seconds=seconds, quick=quick)
    packages = {name for sampler in present for name in sampler.packages} - {"percept"}
    loads = (load_before, os.getloadavg()[0])
    document = build_document(
        measured,
        whole,
        references,
        left_out=left_out,
        made=made_by(command, sorted(packages)),
        at=machine(loads, time.perf_counter() - begun),
    )
    write_benchmark(document, out)


def _whole(repeats: int, *, quick: bool, without: Sequence[str]) -> list[Whole]:
    """Time whole commands; a quick benchmark leaves the longest out."""
    commands = {}
    for name, words in COMMANDS.items():
        if name not in without and not (quick and name in LONGEST):
            commands[name] = words
    sessions = str(dataset("hbfd_sessions.csv"))
    scene = str(dataset("hbfd.toml"))
    return whole_commands(sessions, scene, repeats=repeats, commands=commands)


def write_benchmark(document: Benchmark, out: Path) -> None:
    """Write a benchmark's document, figures and page."""
    series = dict.fromkeys((row.study, row.engine) for row in document.reached)
    levels = dict.fromkeys(row.level for row in document.reached)
    write_page(out / "benchmark.json", dumps(plain(document)))
    drawings = [_against_error(document, study) for study in document.studies]
    page = render_standalone(
        "reports.benchmark.peers",
        "benchmark.html.j2",
        draw_all(drawings, out / "figures"),
        digits=3,
        document=document,
        made=document.made,
        names={sampler.name: sampler for sampler in document.engines},
        levels=list(levels),
        series=list(series),
        at={(row.study, row.engine, row.level): row for row in document.reached},
    )
    write_page(out / PAGE, page)


def _against_error(document: Benchmark, study: StudyFacts) -> Drawing:
    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, frame=Frame(left=18.0, bottom=30.0))
        for sampler, name in zip(document.engines, _COLOURS, strict=False):
            rows = []
            for row in document.measured:
                if (row.study, row.engine) == (study.name, sampler.name):
                    rows.append(row)
            rows.sort(key=lambda row: row.size)
            errors = [100.0 * row.error for row in rows]
            times = [row.warm for row in rows]
            colour = COLOURS[name]
            ax.plot(errors, times, color=colour, marker="o", markersize=3.5, label=sampler.title)
        log_scale(ax)
        ax.set_xlabel("error of the limits (% of half-width)")
        ax.set_ylabel("time (s)")
        ax.margins(y=0.08)
        legend(ax, ncols=2)

    return Drawing(
        f"time-{study.name}",
        f"Run time against error, {study.name}",
        f"{study.about}. Median time of sampling and limits over the root mean square error of"
        " all limits; each mark is one budget, each line one engine. Left and down is better.",
        (170.0, 118.0),
        draw,
    )
