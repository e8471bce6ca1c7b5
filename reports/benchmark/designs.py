"""Ordinary studies of many shapes: what a fit costs, and whether nutpie finds the same limits.

``python -m reports.benchmark.designs TASK`` is the process of one fit, or of nutpie on the same
data. It prints JSON.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from percept.errors import RefusalError, UsageError
from reports.benchmark.measure import Printed, in_a_process, print_result
from reports.benchmark.simulated import DESIGNS, simulated
from reports.command import say
from reports.store import store

if TYPE_CHECKING:
    from percept.study.prepare import Prepared


_PATIENCE = 10.0  # Times the allowed time after which a fit is given up
_LEAST_PATIENCE = 300.0  # s, at least: a loaded machine is slow
_SAMPLING = 180.0  # s that nutpie samples
#: Draws of each chain that are not kept; nutpie's default is 300 to 400: rare shapes adapt late.
_WARM_UP = 2000
#: Draws of each chain, unless time ends first.
_DRAWS = 10_000
#: Share of steps accepted: above the default of 0.8, for divergences would bias the comparison.
_ACCEPTANCE = 0.95
#: Draws per chain below which a limit's Monte Carlo error is itself unknown.
_FEWEST_DRAWS = 100
_PEER_PATIENCE = 900.0  # s that its process may take, with compiling
_KINDS = 2  # mean and user: their limits are compared
_FAR = 3.0  # Combined errors that a difference is counted beyond
_MUCH_MEMORY = 1000.0  # MB


@dataclass(frozen=True)
class DesignCost:
    """Fits of simulated studies to the default tolerance, from the model to the gate."""

    design: Annotated[
        str,
        "Subjects x environments x levels of factors x trials. weak: sigma_w = 0.02. none: sigma_w"
        " = 0, k-b correlation 0.9. irregular: a fifth of the cells missing, 1 to 4 trials (10x5: 1"
        " to 6; 40x20: 2 to 5, none missing). outlier: one subject three times off. k: stiffness"
        " only. own: subjects have trial SDs of their own. covariate: it varies by trial.",
    ]
    seed: Annotated[int, "Of the data and of the fit."]
    allowed_s: Annotated[float, "Time the fit may take, s."]
    in_time: Annotated[bool, "Whether the processor time is within it."]
    in_wall_time: Annotated[
        bool, "Whether the wall time is within it, which other work on the machine stretches."
    ]
    wall_s: Annotated[float, "Wall time: warm-up and run, s."]
    processor_s: Annotated[float, "Processor time of the same, s."]
    coordinates: Annotated[int, "Of the density."]
    steps: Annotated[int, "Steps per ensemble."]
    tau: Annotated[float, "Autocorrelation time of the slowest quantity, steps."]
    rhat: Annotated[float, "Largest rank R-hat."]
    worst_error: Annotated[float, "Largest Monte Carlo error over half-width."]
    passed: Annotated[bool, "Whether the gate passed."]
    reasons: Annotated[str, "What the gate or the refusal said."]
    peak_mb: Annotated[float, "Peak memory of the process, MB."]
    peer_s: Annotated[float | None, "Wall time of nutpie's sampling, s, without compiling."] = None
    peer_draws: Annotated[int | None, "Its draws, all chains."] = None
    divergences: Annotated[int | None, "Its divergences."] = None
    peer_error: Annotated[
        float | None, "Its stated errors over percept's: median of the limits compared."
    ] = None
    z_square: Annotated[
        float | None,
        "Mean square of differences over the combined stated errors, kinds mean and user.",
    ] = None
    z_beyond_3: Annotated[int | None, "Differences beyond 3 combined errors."] = None
    z_largest: Annotated[float | None, "The largest, in combined errors."] = None
    compared: Annotated[int | None, "Limits compared."] = None


def design_costs(
    names: Sequence[str] = (),
    *,
    seeds: Sequence[int] = (1, 2, 3),
    peer: bool = True,
    out: Path | None = None,
) -> list[DesignCost]:
    """Fit designs, each in a process of its own; let nutpie sample the data of the first seed.

    Parameters
    ----------
    names : sequence of str, optional
        Of `DESIGNS`; all of them by default.
    seeds : sequence of int
        One study of each.
    peer : bool
        Whether nutpie runs where its result is not kept yet.
    out : Path, optional
        Folder that keeps what is done, line by line, and what is taken from there.

    Returns
    -------
    list of DesignCost
        Design by design, seed by seed.

    Raises
    ------
    UsageError
        A name that is no design.
    """
    for name in names:
        if name not in DESIGNS:
            message = f"no such design; there are {', '.join(DESIGNS)}."
            raise UsageError(message, key="--rows", value=name)
    rows = []
    for name in names or DESIGNS:
        design = DESIGNS[name]
        for seed in seeds:
            fit = _result(out, "fit", name, seed)
            assert fit is not None
            fitted = fit["cost"]["steps"] > 0
            row = DesignCost(
                name,
                seed,
                design.allowed,
                in_time=fitted and fit["cost"]["processor_s"] <= design.allowed,
                in_wall_time=fitted and fit["cost"]["wall_s"] <= design.allowed,
                **fit["cost"],
            )
            run = peer and design.peer and seed == seeds[0]
            theirs = _result(out, "peer", name, seed, run=run)
            rows.append(_compared(row, fit, theirs) if theirs else row)
    return rows


def _result(
    folder: Path | None, task: str, name: str, seed: int, *, run: bool = True
) -> Printed | None:
    """Take the result of one process from what is kept, or run it; None without either."""
    kept = store(folder, f"{name} {task} {DESIGNS[name].plan}")
    results = kept.read()
    if seed not in results and run:
        say(f"{name}, seed {seed}: {task}")
        results[seed] = _measured(task, name, seed)
        kept.append(seed, results[seed])
    return results.get(seed)


def _measured(task: str, name: str, seed: int) -> Printed:
    """Fit one study, or let nutpie sample it, in a process of its own; its time if that fails."""
    patience = _PEER_PATIENCE
    if task == "fit":
        patience = max(_PATIENCE * DESIGNS[name].allowed, _LEAST_PATIENCE)
    begun = time.perf_counter()
    try:
        return in_a_process(__name__, [task, name, seed], timeout=patience)
    except RefusalError as error:
        wall = time.perf_counter() - begun
        if task == "peer":
            return {"cost": {"peer_s": wall}}
        unknown = dict.fromkeys(("processor_s", "tau", "rhat", "worst_error", "peak_mb"), math.nan)
        lost = {"coordinates": 0, "steps": 0, "passed": False, "reasons": error.message}
        return {"cost": {"wall_s": wall, **lost, **unknown}}


def _compared(row: DesignCost, fit: Printed, peer: Printed) -> DesignCost:
    """Add what nutpie took, and how far its limits lie from percept's in combined errors."""
    row = replace(row, **peer["cost"])
    if "value" not in fit or "value" not in peer:
        return row
    ours = np.array(fit["error"])
    theirs = np.array(peer["error"])
    difference = np.array(fit["value"]) - np.array(peer["value"])
    z = np.abs(difference) / np.hypot(ours, theirs)
    return replace(
        row,
        peer_error=float(np.median(theirs / ours)),
        z_square=float(np.mean(z**2)),
        z_beyond_3=int((z > _FAR).sum()),
        z_largest=float(z.max()),
        compared=z.size,
    )


def summary(rows: Sequence[DesignCost]) -> list[str]:
    """Say over all designs what the table shows of each.

    Parameters
    ----------
    rows : sequence of DesignCost
        As `design_costs` gives them.

    Returns
    -------
    list of str
        Sentences, each for a paragraph of its own.
    """
    on_wall = sum(row.in_wall_time for row in rows)
    wall = sum(row.wall_s for row in rows)
    processor = np.nansum([row.processor_s for row in rows])
    peer = sum(row.peer_s or 0.0 for row in rows)
    lines = [
        _counted(rows, "pass the gate", [row.passed for row in rows]),
        _counted(rows, "end within their time by processor time", [row.in_time for row in rows]),
        _counted(rows, "stay below 1 GB of memory", [row.peak_mb < _MUCH_MEMORY for row in rows]),
        f"By wall time, {on_wall} of {len(rows)} fits end within their time: other work on the"
        " machine counts there.",
        f"Together the fits took {wall:,.0f} s of wall time and {processor:,.0f} s of processor"
        f" time, and nutpie's sampling {peer:,.0f} s. Rows are kept as they are measured: the run"
        " named above may have measured only some of them, or none.",
    ]
    compared = [row for row in rows if row.z_square is not None]
    if compared:
        lines += _against_nutpie(compared)
    done = {row.design for row in compared}
    alone = [name for name in dict.fromkeys(row.design for row in rows) if name not in done]
    if alone:
        lines.append(f"Nutpie has not run, or gave no limits to compare, on {', '.join(alone)}.")
    return lines


def _counted(rows: Sequence[DesignCost], what: str, true: Sequence[bool]) -> str:
    """Say of how many fits something is true, and name the others."""
    others = []
    for row, kept in zip(rows, true, strict=True):
        if not kept:
            others.append(f"{row.design} (seed {row.seed})")
    rest = f"; not {', '.join(others)}" if others else ""
    return f"{sum(true)} of {len(rows)} fits {what}{rest}."


def _against_nutpie(rows: Sequence[DesignCost]) -> list[str]:
    """Say how far nutpie's limits lie from percept's, over rows that compare them."""
    counts = np.array([row.compared for row in rows], dtype=float)
    squares = np.array([row.z_square for row in rows], dtype=float)
    beyond = sum(row.z_beyond_3 or 0 for row in rows)
    largest = max(row.z_largest or 0.0 for row in rows)
    limits = counts.sum()
    coarse = [row.design for row in rows if (row.peer_error or 0.0) > 1.0]
    return [
        f"Against nutpie, {limits:.0f} limits of kinds mean and user: differences over combined"
        " errors have a root mean square of"
        f" {math.sqrt(np.average(squares, weights=counts)):.2f}; {beyond / limits:.2%} exceed 3;"
        f" the largest is {largest:.2f}.",
        f"Nutpie's own error exceeds percept's in {', '.join(coarse) or 'none of them'}.",
    ]


# One process


def _fit(study: Prepared, seed: int) -> Printed:
    """Fit to the default tolerance; limits of kinds mean and user, and what they cost."""
    import resource

    from percept.inference.model.interval_estimands import IntervalEstimands
    from percept.inference.sampling.gate import Settings
    from percept.inference.sampling.run import sample

    model = study.model
    started = time.perf_counter()
    before = time.process_time()
    run = sample(model, IntervalEstimands(model), Settings(seed=seed))
    wall = time.perf_counter() - started
    processor = time.process_time() - before
    gate = run.gate
    cost = {
        "coordinates": len(model.names),
        "wall_s": wall,
        "processor_s": processor,
        "steps": run.steps,
        "tau": gate.autocorrelation_time,
        "rhat": gate.rhat,
        "worst_error": gate.worst_error,
        "passed": gate.passed,
        "reasons": " ".join([*gate.reasons, gate.error_reached]).strip(),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    # The kinds mean and user come first, each with two limits of every cell.
    limits = 2 * _KINDS * len(model.cells)
    value = run.estimates.value[:limits]
    return {"cost": cost, "value": value, "error": run.errors[:limits]}


def _nutpie(study: Prepared, seed: int) -> Printed:
    """Sample for at most `_SAMPLING`; limits of kinds mean and user, and what the run took."""
    from reports.benchmark.nutpie import (
        CHAINS,
        limits_of_draws,
        nutpie_sampler,
        observed,
        plain_model,
    )

    draw = nutpie_sampler(plain_model(observed(study)), ["beta", "spread"])
    # A thread per chain, whatever the processors: a run cut short then has draws of every chain.
    drawn = draw(
        _DRAWS,
        tune=_WARM_UP,
        cores=CHAINS,
        seed=seed,
        target_accept=_ACCEPTANCE,
        patience=_SAMPLING,
    )
    beta = drawn.values["beta"]
    done = np.isfinite(beta[:, :, 0, 0]).sum(axis=1)
    length = int(done.min())
    if length < _FEWEST_DRAWS:
        return {"cost": {"peer_s": drawn.seconds, "peer_draws": int(done.sum())}}
    rng = np.random.default_rng(seed)
    value, error, _ = limits_of_draws(beta[:, :length], drawn.values["spread"][:, :length], rng)
    cost = {
        "peer_s": drawn.seconds,
        "peer_draws": CHAINS * length,
        "divergences": drawn.divergences,
    }
    return {"cost": cost, "value": value[:_KINDS].ravel(), "error": error[:_KINDS].ravel()}


def _main(task: str) -> None:
    """Do one task and print what it gave."""
    kind, name, seed = json.loads(task)
    study = simulated(DESIGNS[name], seed)
    print_result(_nutpie(study, seed) if kind == "peer" else _fit(study, seed))


if __name__ == "__main__":
    _main(sys.argv[1])
