"""Everything the page and benchmark.json hold: what was measured, and what follows from it."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from percept import __version__
from percept.bench.growth import Growth
from percept.bench.measure import machine
from percept.bench.peers.engines import ENGINES, Engine, engine
from percept.bench.peers.measure import Measured, Startup
from percept.bench.peers.reference import Reference
from percept.bench.peers.whole import Comparison, Whole, comparisons
from percept.report.plain import plain

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
    command: str,
    loads: tuple[float, float],
    seconds: float,
) -> dict[str, Any]:
    """Collect a run."""
    times = reached(measured)
    compared = comparisons(whole) if whole else []
    promises = _promises(measured, times)
    run_engines = [one for one in ENGINES if one.name in {row.engine for row in measured}]
    document = {
        "schema": SCHEMA,
        "command": command,
        "machine": machine(loads, seconds),
        "versions": _versions(run_engines),
        "reference": {
            "command": reference.command, "own_effective": reference.own.effective,
            "own_runs": reference.own.runs, "own_scatter": reference.own.scatter,
            "other_effective": reference.other.effective, "other_runs": reference.other.runs,
            "other_scatter": reference.other.scatter, "worst_apart": np.abs(reference.apart).max(),
            "mean_square_apart": (reference.apart**2).mean(),
            "relative_error": np.sqrt(((reference.own.error / reference.half_width) ** 2).mean()),
        },
        "engines": [{"name": one.name, "title": one.title, "unit": one.unit} for one in run_engines],
        "startups": startups,
        "measured": measured,
        "reached": times,
        "whole": whole,
        "comparisons": [dataclasses.asdict(one) | {"kept": one.kept} for one in compared],
        "growth": growth,
        "promises": promises,
        "losses": _losses(times, promises, compared) + _grown(growth),
    }  # fmt: skip
    found: dict[str, Any] = plain(document)
    return found


def _versions(engines: Sequence[Engine]) -> dict[str, str]:
    """Versions of what is installed here: rows may have been measured elsewhere."""
    names = sorted({name for one in engines for name in one.packages})
    installed = {one.name.lower(): one.version for one in importlib.metadata.distributions()}
    return {"percept": __version__} | {name: installed[name] for name in names if name in installed}


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
    times: Sequence[Reached], promises: Sequence[dict[str, Any]], compared: Sequence[Comparison]
) -> list[str]:
    """Say where percept is not the fastest, or a promise is not kept."""
    found = []
    for row in times:
        if (row.engine, row.how) == _OURS:
            continue
        for state, ratio in (("warm", row.warm_ratio), ("cold", row.cold_ratio)):
            if ratio < 1.0:
                title = f"{engine(row.engine).title} ({row.how})"
                found.append(
                    f"{title} reaches {row.level:.1%} {state} in {ratio:.2f} times percept’s time"
                    + (", extrapolated." if row.extrapolated else ".")
                )
    for promise in promises:
        what, value, aim = promise["what"], promise["value"], promise["aim"]
        if value < aim if promise["more_is_better"] else value > aim:
            found.append(f"{what[0].upper()}{what[1:]}: {value:.3g}; {aim:g} is the aim.")
    for one in compared:
        if not one.kept:
            found.append(
                f"{one.command} takes {one.ratio:.2f} times as long as {one.against}; "
                f"{one.promised:g} is promised."
            )
    return found


def _grown(growth: Sequence[Growth]) -> list[str]:
    """Say where run time grows more than is promised."""
    return [
        f"With {one.along} a {one.task} at {one.size} takes {one.ratio:.2f} times as long as at the least; "
        f"{one.promised:g} is promised."
        for one in growth
        if one.promised is not None and one.ratio > one.promised
    ]
