"""The benchmark: run what is installed on every study, and write benchmark.json, figures and the page."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from percept.bench.measure import Machine, machine
from percept.bench.peers.engines import ENGINES, STUDIES, Engine, engine
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

__all__ = [
    "PAGE",
    "Aim",
    "Benchmark",
    "Plan",
    "Reached",
    "build_document",
    "reached",
    "run_benchmark",
    "write_benchmark",
]

PAGE = "index.html"
_SCHEMA = "percept-benchmark-2"
_FILES = FolderFiles(PAGE, (PAGE, "benchmark.json", "figures/time-*.svg"))
#: Errors over half-width at which times are compared.
_LEVELS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_OURS = "percept"
_PLAIN = "nutpie"
_USUAL_DRAWS = 1000  # Per chain: samplers of this kind take so many where nothing else is asked for
_RATIO = 2.0  # Time goes with the error to this power, once a sampler has converged
_AIM_LEVEL = 0.01  # Error at which sampling times are compared with what percept aims at
_AIM_DRAWS = 1000.0  # Times nutpie's effective draws per second
_AIM_TIME = 5000.0  # Times faster than nutpie to that error
_EXTRA = "pip install 'percept[peers]'"
_COLOURS = ("bayesian", "ink", "classical", "warn", "coupled")


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a benchmark measures; empty names stand for all."""

    engines: Sequence[str] = ()
    studies: Sequence[str] = ()
    seconds: float = 150.0  # After which no run of an engine begins
    repeats: int = 5  # Rounds of whole commands
    quick: bool = False  # The smallest budgets, to see that all works


@dataclasses.dataclass(frozen=True)
class Reached:
    """Time of one engine to one error, and how much longer that is than percept's."""

    study: str
    engine: str
    level: float  # Error over half-width
    warm: float  # s
    cold: float  # s
    processor: float  # s
    extrapolated: bool  # Whether the most accurate run's time over error squared stands here
    warm_ratio: float  # Over percept's times to the same error, as the next two; NaN without them
    cold_ratio: float
    processor_ratio: float


@dataclasses.dataclass(frozen=True)
class Aim:
    """A ratio of percept to nutpie, and what percept aims at."""

    what: str
    value: float  # By wall time
    processor: float
    aim: float


@dataclasses.dataclass(frozen=True)
class _Study:
    """A study and the limits that errors are measured against."""

    name: str
    about: str
    limits: int
    runs: int
    effective: float
    scatter: float
    relative_error: float


@dataclasses.dataclass(frozen=True)
class _Title:
    """An engine as the page names it."""

    name: str
    title: str
    unit: str


@dataclasses.dataclass(frozen=True)
class _LeftOut:
    name: str
    missing: list[str]  # Packages


@dataclasses.dataclass(frozen=True)
class Benchmark:
    """A run, as benchmark.json holds it."""

    schema: str
    made: Made
    machine: Machine
    studies: list[_Study]
    engines: list[_Title]
    left_out: list[_LeftOut]
    measured: Sequence[Measured]
    reached: list[Reached]
    whole: Sequence[Whole]
    comparisons: list[Comparison]
    aims: list[Aim]
    losses: list[str]


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
        Folder of the page, made where it does not exist.
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
    references = {name: stored_reference(name) for name in plan.studies or stored_references()}
    present = [one for one in chosen if not one.missing]
    left_out = {one.title: one.missing for one in chosen if one.missing}
    for title, missing in left_out.items():
        log(f"{title}: left out, {', '.join(missing)} not installed; {_EXTRA}")
    if not present:
        names = ", ".join(plan.engines)
        raise RefusalError("none of these engines is installed.", value=names, hint=_EXTRA)
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
    names = {name for one in engines for name in one.packages}
    return sorted(names - {"percept"})


@dataclasses.dataclass(frozen=True)
class _Times:
    """Of one engine to one error, s."""

    warm: float
    cold: float
    processor: float
    extrapolated: bool


def reached(measured: Sequence[Measured], levels: Sequence[float] = _LEVELS) -> list[Reached]:
    """Work out times to given errors, and their ratios to percept's."""
    groups: dict[tuple[str, str], list[Measured]] = {}
    for row in measured:
        groups.setdefault((row.study, row.engine), []).append(row)
    rows = []
    for (study, name), group in groups.items():
        own_group = groups.get((study, _OURS))
        for level in levels:
            times = _time_to(level, group)
            own = _time_to(level, own_group) if own_group else _NOT_MEASURED
            rows.append(
                Reached(
                    study,
                    name,
                    level,
                    times.warm,
                    times.cold,
                    times.processor,
                    times.extrapolated,
                    times.warm / own.warm,
                    times.cold / own.cold,
                    times.processor / own.processor,
                )
            )
    return rows


_NOT_MEASURED = _Times(math.nan, math.nan, math.nan, extrapolated=False)


def _time_to(level: float, group: Sequence[Measured]) -> _Times:
    """Return the times to an error: of the fastest run that is as accurate, or extrapolated."""
    enough = [row for row in group if row.error <= level]
    if enough:
        best = min(enough, key=lambda row: row.warm)
        more = 1.0
    else:
        best = min(group, key=lambda row: row.error)
        more = (best.error / level) ** _RATIO
    start = best.cold - best.warm
    warm = best.warm * more
    return _Times(warm, start + warm, best.processor * more, extrapolated=not enough)


def build_document(
    measured: Sequence[Measured],
    whole: Sequence[Whole],
    references: Mapping[str, Reference],
    *,
    made: Made,
    at: Machine,
    left_out: Mapping[str, Sequence[str]] | None = None,
) -> Benchmark:
    """Collect a run.

    Parameters
    ----------
    measured : sequence of Measured
        Engines on studies.
    whole : sequence of Whole
        Whole commands.
    references : mapping
        By study, in the page's order.
    made : Made
        What the page was made by.
    at : Machine
        Where.
    left_out : mapping, optional
        What was left out, with the packages it misses.

    Returns
    -------
    Benchmark
        With times to given errors, ratios, and where percept does not win.
    """
    times = reached(measured)
    compared = comparisons(whole)
    aims = _aims(measured, times)
    present = {row.engine for row in measured}
    studies = []
    for name, one in references.items():
        error = one.relative_error(one.value + one.error)
        about = STUDIES.get(name, name)
        studies.append(
            _Study(name, about, one.value.size, one.runs, one.effective, one.scatter, error)
        )
    return Benchmark(
        schema=_SCHEMA,
        made=made,
        machine=at,
        studies=studies,
        engines=[_Title(one.name, one.title, one.unit) for one in ENGINES if one.name in present],
        left_out=[_LeftOut(name, list(missing)) for name, missing in (left_out or {}).items()],
        measured=measured,
        reached=times,
        whole=whole,
        comparisons=compared,
        aims=aims,
        losses=[*_slower(times), *_missed(aims), *_broken(compared)],
    )


def _aims(measured: Sequence[Measured], times: Sequence[Reached]) -> list[Aim]:
    """Compare percept and nutpie on the plain model of the first study with what percept aims at."""
    study = measured[0].study
    theirs = [row for row in measured if (row.study, row.engine) == (study, _PLAIN)]
    ours = [row for row in measured if (row.study, row.engine) == (study, _OURS)]
    if not theirs or not ours:
        return []
    best = max(ours, key=lambda row: row.effective_per_second)
    # With divergences its effective draws vary many times from run to run: what users take.
    usual = min(theirs, key=lambda row: abs(row.size - _USUAL_DRAWS))
    plain_at_aim = (study, _PLAIN, _AIM_LEVEL)
    to_aim = next(row for row in times if (row.study, row.engine, row.level) == plain_at_aim)
    of_draws = Aim(
        f"effective draws per second over nutpie’s, 4 × {usual.size:.0f} draws",
        best.effective_per_second / usual.effective_per_second,
        best.effective_per_processor_second / usual.effective_per_processor_second,
        _AIM_DRAWS,
    )
    of_time = Aim(
        f"nutpie’s sampling time to an error of {100 * _AIM_LEVEL:g} %, over percept’s",
        to_aim.warm_ratio,
        to_aim.processor_ratio,
        _AIM_TIME,
    )
    return [of_draws, of_time]


def _slower(times: Sequence[Reached]) -> list[str]:
    """Say where another engine is faster than percept."""
    lines = []
    for row in times:
        if row.engine == _OURS:
            continue
        extrapolated = ", extrapolated" if row.extrapolated else ""
        for state, ratio in (("warm", row.warm_ratio), ("cold", row.cold_ratio)):
            if ratio < 1.0:
                lines.append(
                    f"{row.study}: {engine(row.engine).title} reaches {row.level:.1%} {state} in"
                    f" {ratio:.2f} times percept’s time{extrapolated}."
                )
    return lines


def _missed(aims: Sequence[Aim]) -> list[str]:
    """Say which aims are not reached."""
    lines = []
    for one in aims:
        if one.value < one.aim:
            what = one.what[0].upper() + one.what[1:]
            lines.append(f"{what}: {one.value:.3g}; {one.aim:g} is the aim.")
    return lines


def _broken(compared: Sequence[Comparison]) -> list[str]:
    """Say which promised ratios of whole commands are not kept."""
    lines = []
    for one in compared:
        if not one.kept:
            lines.append(
                f"{one.command} takes {one.ratio:.2f} times the wall time and"
                f" {one.processor_ratio:.2f} times the processor time of {one.against};"
                f" {one.promised:g} is promised."
            )
    return lines


def write_benchmark(document: Benchmark, out_dir: str | Path, *, force: bool = False) -> Path:
    """Write a benchmark's document, figures and page; return the page's path."""
    series = dict.fromkeys((row.study, row.engine) for row in document.reached)
    levels = dict.fromkeys(row.level for row in document.reached)
    with filled_folder(out_dir, _FILES, force=force) as folder:
        (folder / "benchmark.json").write_text(dumps(plain(document)), encoding="utf-8")
        drawings = [_against_error(document, study) for study in document.studies]
        page = render_standalone(
            "percept.bench.peers",
            "benchmark.html.j2",
            draw_all(drawings, folder / "figures"),
            digits=3,
            document=document,
            made=document.made,
            names={one.name: one for one in document.engines},
            levels=list(levels),
            series=list(series),
            at={(row.study, row.engine, row.level): row for row in document.reached},
        )
        (folder / PAGE).write_text(page, encoding="utf-8")
    return Path(out_dir) / PAGE


def _against_error(document: Benchmark, study: _Study) -> Drawing:
    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, left=18.0, bottom=30.0)
        for one, name in zip(document.engines, _COLOURS, strict=False):
            rows = []
            for row in document.measured:
                if (row.study, row.engine) == (study.name, one.name):
                    rows.append(row)
            rows.sort(key=lambda row: row.size)
            errors = [100.0 * row.error for row in rows]
            times = [row.warm for row in rows]
            colour = COLOURS[name]
            ax.plot(errors, times, color=colour, marker="o", markersize=3.5, label=one.title)
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
