"""Run time against error: percept beside emcee's own moves and nutpie, on the same model."""

from __future__ import annotations

import importlib.util
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, TypeAlias

import numpy as np

from percept.errors import UsageError
from reports.benchmark.reference import (
    STUDIES,
    TOLERANCE,
    Reference,
    stored_reference,
    study_of,
)
from reports.fitted import Fitted, by_percept
from reports.measure import in_a_process
from reports.page import Page, say
from reports.studies import Array, Observed

#: Samples within a budget, in the engine's own unit, from a seed.
Sampler: TypeAlias = Callable[[float, int], Fitted]
#: A run of an engine, as its process prints it.
Run: TypeAlias = dict[str, Any]

#: Errors over half-width at which times are compared.
LEVELS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_OURS = "percept"
_INTRODUCTION = """\
One hierarchical model, the same priors: every engine gives the same interval limits. percept
integrates every location and subject effect out and reads its limits off a mixture of normal laws;
emcee's own moves sample that density too. nutpie has the model written plainly, and its limits are
quantiles of raw draws, as its users take them. The error of a run is the root mean square
difference of its limits from reference limits, over each interval's half-width. A budget is
percept's tolerance, emcee's steps of 256 walkers or of twice the coordinates, and nutpie's draws of
each of 4 chains."""
_MEASURED = """\
Medians over repeats. `cold` adds what the first run of a process takes beyond a later one: imports,
building, compiling. `agreement` is the root mean square of the differences from the reference over
their Monte Carlo errors: about 1 where an engine has converged and knows its own error, far above
where it has not. Effective draws are of the slowest limit."""
_REACHED = """\
percept's rows are its own times in s: warm / cold / processor. All others are ratios to them. Where
no run was accurate enough, time over error squared of the most accurate one stands in italics. That
is the best that can be hoped for: bias, as after divergences, does not shrink with time. Where
percept takes longer, warm or cold, the ratios are bold."""


@dataclass(frozen=True)
class Engine:
    """One way to sample the model."""

    title: str
    budgets: tuple[tuple[float, int], ...]  # Size and repeats of a full run, smallest first
    quick: float  # Size that is enough to see that it works
    needs: str  # Package that it is imported from


ENGINES = {
    "percept": Engine(
        "percept",
        ((0.1, 5), (0.03, 20), (0.02, 5), (0.01, 20), (0.005, 5), (0.003, 20), (0.001, 2)),
        0.1,
        "percept",
    ),
    "emcee": Engine(
        "emcee's stretch moves on percept's density",
        ((1000, 5), (4000, 5), (16000, 3), (64000, 1)),
        200,
        "emcee",
    ),
    "nutpie": Engine(
        "nutpie, written plainly",
        ((250, 5), (1000, 15), (4000, 3), (16000, 1)),
        50,
        "nutpie",
    ),
}


def sampler_of(engine: str, study: Observed) -> Sampler:
    """Build and compile what an engine needs for a study."""
    if engine == "percept":
        return partial(by_percept, study)
    if engine == "emcee":
        from reports.peers import emcee

        return emcee.sampler(study)
    from reports.peers import nutpie

    return nutpie.sampler(study)


def runs_of(
    engine: str, study: str, budgets: Sequence[tuple[float, int]], seconds: float, started: float
) -> list[Run]:
    """Run an engine on a study in this process; the first run comes twice, cold and warm.

    No run begins so many seconds after the process did, at `started`.
    """
    # Samplers warn about runs as short as some of these are meant to be.
    warnings.simplefilter("ignore")
    sampler = sampler_of(engine, study_of(study))
    size, _ = budgets[0]
    sampler(size, 1)
    runs: list[Run] = [{"size": "cold", "seconds": time.time() - started}]
    for size, repeats in budgets:
        for seed in range(2, 2 + repeats):
            if len(runs) > 1 and time.time() - started > seconds:
                return runs
            before = time.process_time()
            fitted = asdict(sampler(size, seed))
            runs.append({"size": size, "processor": time.process_time() - before, **fitted})
    return runs


@dataclass(frozen=True)
class Measured:
    """One engine at one budget; medians over repeats."""

    study: str
    engine: str
    size: float  # Budget in the engine's unit
    repeats: int
    warm: float  # Wall time of sampling and limits, s
    cold: float  # The same with the start of the process, s
    processor: float  # Processor time of a warm run, s
    error: float  # Root mean square over the runs
    effective: float  # Effective draws of the slowest quantity, per s
    agreement: float  # Root mean square of (limit - reference) over the Monte Carlo error of both
    divergences: float | None


def measured(study: str, engine: str, runs: Sequence[Run], reference: Reference) -> list[Measured]:
    """Reduce the runs of an engine to a row for each budget."""
    first, *warm_runs = runs
    by_size: dict[float, list[Run]] = {}
    for run in warm_runs:
        by_size.setdefault(run["size"], []).append(run)
    smallest = next(iter(by_size.values()))
    start = max(first["seconds"] - median(run["seconds"] for run in smallest), 0.0)
    rows = []
    for size, each in by_size.items():
        warm = median(run["seconds"] for run in each)
        values = np.array([run["value"] for run in each])
        claimed = np.hypot([run["error"] for run in each], reference.error)
        squares = [reference.relative_error(value) ** 2 for value in values]
        rows.append(
            Measured(
                study,
                engine,
                size,
                len(each),
                warm,
                start + warm,
                median(run["processor"] for run in each),
                error=float(np.sqrt(np.mean(squares))),
                effective=median(run["effective"] / run["seconds"] for run in each),
                agreement=float(np.sqrt(np.mean(((values - reference.value) / claimed) ** 2))),
                divergences=each[0]["notes"].get("divergences"),
            )
        )
    return rows


def times_to(level: float, group: Sequence[Measured]) -> tuple[Array, bool]:
    """Return warm, cold and processor time to an error, and whether a run was as accurate.

    Without one, the most accurate run is carried on with time over error squared.
    """
    enough = [row for row in group if row.error <= level]
    if enough:
        best = min(enough, key=lambda row: row.warm)
    else:
        best = min(group, key=lambda row: row.error)
    more = 1.0 if enough else (best.error / level) ** 2
    warm = best.warm * more
    return np.array([warm, best.cold - best.warm + warm, best.processor * more]), bool(enough)


def time_cells(group: Sequence[Measured], ours: Sequence[Measured] | None) -> list[str]:
    """Write times to each error, or their ratios to percept's where these are given."""
    cells = []
    for level in LEVELS:
        times, was_measured = times_to(level, group)
        if ours is not None:
            times = times / times_to(level, ours)[0]
        text = " / ".join(f"{value:.3g}" for value in times)
        if ours is not None and times[:2].min() < 1.0:
            text = f"**{text}**"
        cells.append(text if was_measured else f"*{text}*")
    return cells


def page(
    out: Path,
    *,
    studies: tuple[str, ...] = tuple(STUDIES),
    engines: tuple[str, ...] = tuple(ENGINES),
    seconds: float = 150.0,
    quick: bool = False,
) -> Page:
    """Measure run time against error of every installed engine, each in a process of its own.

    Parameters
    ----------
    out : Path
        Folder of the page.
    studies, engines : tuple of str
        What is compared.
    seconds : float
        After which an engine begins no new run on a study.
    quick : bool
        One run of each engine, of the size that shows that it works.

    Returns
    -------
    Page
    """
    for name in engines:
        if name not in ENGINES:
            raise UsageError(f"no such engine; they are {', '.join(ENGINES)}.", value=name)
    installed = [name for name in engines if importlib.util.find_spec(ENGINES[name].needs)]
    by_study: dict[str, dict[str, list[Measured]]] = {}
    for study in studies:
        reference = stored_reference(study)
        by_study[study] = {}
        for engine in installed:
            say(f"{study}: {engine}")
            budgets = ((ENGINES[engine].quick, 1),) if quick else ENGINES[engine].budgets
            runs, _ = in_a_process(runs_of, engine, study, budgets, seconds, time.time())
            by_study[study][engine] = measured(study, engine, runs, reference)
    missing = [ENGINES[name].title for name in engines if name not in installed]
    return written(by_study, missing)


def written(by_study: dict[str, dict[str, list[Measured]]], missing: Sequence[str] = ()) -> Page:
    """Write what was measured as a page."""
    page = Page("Run time against error", _INTRODUCTION)
    if missing:
        page.add(
            f"Not installed, and left out: {', '.join(missing)}."
            " `pip install 'percept-haptics[peers]'` installs what they need."
        )
    page.add("\n".join(f"- {study}: {STUDIES[study]}." for study in by_study))
    reached = []
    rows = []
    for study, groups in by_study.items():
        for engine, group in groups.items():
            ours = None if engine == _OURS else groups.get(_OURS)
            reached.append([study, ENGINES[engine].title, *time_cells(group, ours)])
            for row in group:
                told = list(asdict(row).values())
                rows.append([study, engine, *told[2:]])
    page.add(f"## Time to a given error\n\n{_REACHED}")
    page.table(["study", "engine", *(f"{level:.1%}" for level in LEVELS)], reached)
    page.add(f"## Everything measured\n\n{_MEASURED}")
    heads = ["study", "engine", "budget", "repeats", "warm, s", "cold, s", "processor, s"]
    heads += ["error", "effective draws per s", "agreement", "divergences"]
    page.table(heads, rows)
    page.add(
        f"Reference limits are pooled over 30 runs of percept to a tolerance of {TOLERANCE}."
        " nutpie's agreement checks them by another density and another sampler."
    )
    return page
