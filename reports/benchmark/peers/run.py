"""The benchmark: run what is installed on every study, and write document, figures and page."""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from percept.errors import RefusalError
from percept.files import FolderFiles, filled_folder, refuse_foreign
from percept.provenance import made_by
from percept.report.figures.canvas import COLOURS, Drawing, Frame, legend, log_scale, panels
from percept.report.figures.output import draw_all
from percept.report.page import render_standalone
from percept.results.plain import dumps, plain
from reports import dataset
from reports.benchmark.measure import machine
from reports.benchmark.peers.document import Benchmark, StudyFacts, build_document
from reports.benchmark.peers.engines import ENGINES, STUDIES, Engine, engine
from reports.benchmark.peers.processes import (
    COMMANDS,
    LONGEST,
    Measured,
    Whole,
    measure,
    whole_commands,
)
from reports.benchmark.peers.reference import stored_reference

__all__ = ["PAGE", "Plan", "run_benchmark", "write_benchmark"]

PAGE = "index.html"
_FILES = FolderFiles(PAGE, (PAGE, "benchmark.json", "figures/time-*.svg"))
_EXTRA = "pip install 'percept-haptics[peers]'"
_COLOURS = ("bayesian", "ink", "classical")


@dataclass(frozen=True)
class Plan:
    """What a benchmark measures; empty names stand for all."""

    engines: Sequence[str] = ()
    studies: Sequence[str] = ()
    seconds: float = 150.0  # After which no run of an engine begins
    repeats: int = 5  # Rounds of whole commands
    quick: bool = False  # The smallest budgets, to see that all works


def run_benchmark(
    out: str | Path,
    plan: Plan,
    *,
    command: str,
    force: bool = False,
    log: Callable[[str], None] = lambda line: None,
) -> Path:
    """Measure every installed engine on every study with a reference, and whole commands.

    Parameters
    ----------
    out : str or Path
        Folder of the page, which keeps reference.json.
    plan : Plan
        What is measured.
    command : str
        What was typed, as the page says it.
    force : bool
        Replace also files of the page's names that no earlier run wrote.
    log : callable
        Told of each step.

    Returns
    -------
    Path
        Of the page.

    Raises
    ------
    RefusalError
        Where no engine asked for is installed, or a study has no reference.
    UsageError
        For an engine that does not exist, and for a folder that cannot be written.
    """
    refuse_foreign(out, _FILES, force=force)
    chosen = [engine(name) for name in plan.engines] or list(ENGINES)
    present = [sampler for sampler in chosen if not sampler.missing]
    left_out = {sampler.title: sampler.missing for sampler in chosen if sampler.missing}
    for title, missing in left_out.items():
        log(f"{title}: left out, {', '.join(missing)} not installed; {_EXTRA}")
    if not present:
        names = ", ".join(plan.engines)
        raise RefusalError("none of these engines is installed.", value=names, hint=_EXTRA)
    references = {name: stored_reference(out, name) for name in plan.studies or STUDIES}
    begun = time.perf_counter()
    load_before = os.getloadavg()[0]
    whole: list[Whole] = []
    if plan.repeats:
        if importlib.util.find_spec("pymc") is None:
            left_out["import pymc"] = ("pymc",)
        log("whole commands")
        whole = _whole(plan, without=tuple(left_out))
    measured: list[Measured] = []
    for study, reference in references.items():
        measured += measure(
            present, study, reference, seconds=plan.seconds, quick=plan.quick, log=log
        )
    packages = _packages(present)
    loads = (load_before, os.getloadavg()[0])
    document = build_document(
        measured,
        whole,
        references,
        left_out=left_out,
        made=made_by(command, packages),
        at=machine(loads, time.perf_counter() - begun),
    )
    return write_benchmark(document, out, force=force)


def _whole(plan: Plan, *, without: Sequence[str]) -> list[Whole]:
    """Time whole commands; a quick benchmark leaves the longest out."""
    commands = {}
    for name, words in COMMANDS.items():
        if name not in without and not (plan.quick and name in LONGEST):
            commands[name] = words
    sessions = str(dataset("hbfd_sessions.csv"))
    scene = str(dataset("hbfd.toml"))
    repeats = 0 if plan.quick else plan.repeats
    return whole_commands(sessions, scene, repeats=repeats, commands=commands)


def _packages(engines: Sequence[Engine]) -> list[str]:
    """Return the packages whose versions the page names."""
    names = {name for sampler in engines for name in sampler.packages}
    return sorted(names - {"percept"})


def write_benchmark(document: Benchmark, out_dir: str | Path, *, force: bool = False) -> Path:
    """Write a benchmark's document, figures and page; return the page's path."""
    series = dict.fromkeys((row.study, row.engine) for row in document.reached)
    levels = dict.fromkeys(row.level for row in document.reached)
    with filled_folder(out_dir, _FILES, force=force) as folder:
        (folder / "benchmark.json").write_text(dumps(plain(document)), encoding="utf-8")
        drawings = [_against_error(document, study) for study in document.studies]
        page = render_standalone(
            "reports.benchmark.peers",
            "benchmark.html.j2",
            draw_all(drawings, folder / "figures"),
            digits=3,
            document=document,
            made=document.made,
            names={sampler.name: sampler for sampler in document.engines},
            levels=list(levels),
            series=list(series),
            at={(row.study, row.engine, row.level): row for row in document.reached},
        )
        (folder / PAGE).write_text(page, encoding="utf-8")
    return Path(out_dir) / PAGE


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
