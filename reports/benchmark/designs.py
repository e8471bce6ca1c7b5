"""Ordinary studies of many shapes: what a fit costs, and whether nutpie finds the same limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from percept.checkpoint import Line, plan_digest
from percept.errors import RefusalError, UsageError
from reports.benchmark.simulated import DESIGNS, StudyDesign, simulated
from reports.calibration.studies import KINDS, Kind, draw_study
from reports.fitted import Fitted, by_percept
from reports.measure import in_a_process
from reports.page import Page, say, store
from reports.studies import Observed

_TWICE = Kind(16, 5, (2, 2), factors=("hand",), parameters=("k", "b"))
_OWN = Kind(12, 5, (3, 3), own_trial_sds=True, parameters=("k", "b"))
#: Drawn from the prior. Of those with subjects' own trial SDs a plain design is the same with one.
FACTORS: Mapping[str, Kind] = {
    "16x5x2, factor": _TWICE,
    "16x5x2, factor and covariate": replace(_TWICE, covariate=True),
    "40x6x2x2, factors and covariate": replace(
        _TWICE, subjects=40, environments=6, factors=("hand", "load"), covariate=True
    ),
    "300x5x2, factor": replace(_TWICE, subjects=300),
    "12x5x3, own trial SDs": _OWN,
    "40x6x10, own trial SDs": replace(_OWN, subjects=40, environments=6, trials=(10, 10)),
    **{name: kind for name, kind in KINDS.items() if kind.factors or kind.own_trial_sds},
}
STUDIES: Mapping[str, StudyDesign | Kind] = {**DESIGNS, **FACTORS}

_TOLERANCE = 0.01  # percept's default
_PATIENCE = 900.0  # s that a process may take, with compiling
_SAMPLING = 180.0  # s that nutpie samples
#: Draws of each chain that are not kept; nutpie's default is 300 to 400: rare shapes adapt late.
_WARM_UP = 2000
#: Draws of each chain, unless time ends first.
_DRAWS = 10_000
#: Share of steps accepted: above the default of 0.8, for divergences would bias the comparison.
_ACCEPTANCE = 0.95
_FAR = 3.0  # Combined errors that a difference is counted beyond
_INTRODUCTION = """\
Fits of simulated studies to the default tolerance, each in a process of its own. A design is
subjects x environments x trials. weak: sigma_w = 0.02. none: sigma_w = 0, and a correlation of 0.9.
irregular: a fifth of the cells missing, and 1 to 4 trials (10x5: 1 to 6; 40x20: 2 to 5, none
missing). outlier: one subject three times off. k: stiffness only. Others are drawn from the prior.
Processor time and memory are those of the whole process."""
_NUTPIE = """\
nutpie has the model written plainly, and samples the data of the first seed with {chains} draws,
for at most {seconds:.0f} s. Its limits of means and of the next user are compared with percept's: a
difference is divided by the root of the sum of both squared Monte Carlo errors. {counted}"""


@dataclass(frozen=True)
class Row:
    """One fit, and how far nutpie's limits lie from its own."""

    design: str
    seed: int
    processor: float  # s
    wall: float  # s
    memory: float  # MB
    steps: float
    error: float  # The largest over the half-width
    passed: bool
    nutpie: float | None = None  # s of sampling
    divergences: float | None = None
    times: float | None = None  # nutpie's errors over percept's, median
    apart: float | None = None  # Root mean square difference in combined errors
    farthest: float | None = None
    limits: int | None = None
    far: int | None = None  # Beyond `_FAR` combined errors


def observed(name: str, seed: int) -> Observed:
    """Draw a study."""
    study = STUDIES[name]
    if isinstance(study, StudyDesign):
        return simulated(study, seed)
    return draw_study(study, np.random.default_rng(seed)).observed


def fit_by_percept(name: str, seed: int) -> Line:
    """Fit one study to the default tolerance."""
    return _kept(by_percept(observed(name, seed), _TOLERANCE, seed))


def fit_by_nutpie(name: str, seed: int) -> Line:
    """Let nutpie sample one study, at most so long."""
    from reports.peers import nutpie

    sampler = nutpie.sampler(observed(name, seed), centred=False)
    # A thread per chain, whatever the processors: a run cut short then has draws of every chain.
    return _kept(
        sampler(
            _DRAWS,
            seed,
            tune=_WARM_UP,
            cores=nutpie.CHAINS,
            target_accept=_ACCEPTANCE,
            patience=_SAMPLING,
        )
    )


def _kept(fitted: Fitted) -> Line:
    """Return what is compared: limits of the kinds mean and user."""
    line = asdict(fitted)
    return line | {"value": fitted.value[:2].ravel(), "error": fitted.error[:2].ravel()}


def row_of(name: str, seed: int) -> tuple[Row, Line]:
    """Fit one study in a process of its own."""
    say(f"{name}, seed {seed}")
    try:
        fit, cost = in_a_process(fit_by_percept, name, seed, timeout=_PATIENCE)
    except RefusalError as error:
        say(error.message)
        return Row(name, seed, math.nan, math.nan, math.nan, 0.0, math.nan, passed=False), {}
    notes = fit["notes"]
    row = Row(
        name,
        seed,
        cost.processor,
        cost.wall,
        cost.memory,
        notes["steps"],
        notes["error"],
        passed=bool(notes["passed"]),
    )
    return row, fit


def beside(row: Row, fit: Line, peer: Line) -> Row:
    """Add how far nutpie's limits lie from percept's."""
    ours = np.array(fit["error"])
    theirs = np.array(peer["error"])
    apart = np.abs(np.array(fit["value"]) - np.array(peer["value"])) / np.hypot(ours, theirs)
    fields = asdict(row) | {
        "nutpie": peer["seconds"],
        "divergences": peer["notes"].get("divergences"),
        "times": float(np.median(theirs / ours)),
        "apart": float(np.sqrt(np.mean(apart**2))),
        "farthest": float(apart.max()),
        "limits": apart.size,
        "far": int((apart > _FAR).sum()),
    }
    return Row(**fields)


def by_nutpie(name: str, seed: int, out: Path, *, sample: bool) -> Line | None:
    """Take nutpie's limits from what is kept, or sample them; None where they are not known."""
    kept = store(out, f"{name} {plan_digest(STUDIES[name])}")
    results = kept.read()
    if seed not in results and sample:
        say(f"{name}: nutpie")
        try:
            results[seed], _ = in_a_process(fit_by_nutpie, name, seed, timeout=_PATIENCE)
        except RefusalError as error:
            say(error.message)
            return None
        kept.append(seed, results[seed])
    return results.get(seed)


def page(
    out: Path,
    *,
    rows: tuple[str, ...] = tuple(STUDIES),
    seeds: int = 3,
    nutpie: bool = False,
) -> Page:
    """Fit studies of many shapes, and compare their limits with nutpie's.

    Parameters
    ----------
    out : Path
        Folder of the page, which keeps nutpie's limits.
    rows : tuple of str
        Names of the studies.
    seeds : int
        Studies of each shape.
    nutpie : bool
        Whether nutpie samples what is not kept yet.

    Returns
    -------
    Page
    """
    found = []
    for name in rows:
        if name not in STUDIES:
            raise UsageError(f"no such design; there are {', '.join(STUDIES)}.", value=name)
        for seed in range(1, seeds + 1):
            row, fit = row_of(name, seed)
            design = STUDIES[name]
            peer = None
            if fit and seed == 1:
                may_sample = nutpie and (isinstance(design, Kind) or design.peer)
                peer = by_nutpie(name, seed, out, sample=may_sample)
            found.append(beside(row, fit, peer) if peer else row)
    return written(found)


def written(rows: Sequence[Row]) -> Page:
    """Write the rows, and what they say together."""
    failed = [f"{row.design} (seed {row.seed})" for row in rows if not row.passed]
    compared = [row for row in rows if row.limits]
    counted = "No limits are compared."
    if compared:
        limits = np.array([row.limits for row in compared])
        far = sum(row.far or 0 for row in compared)
        squares = np.array([row.apart for row in compared]) ** 2
        rms = math.sqrt(np.average(squares, weights=limits))
        farthest = max(row.farthest or 0.0 for row in compared)
        counted = (
            f"Of {limits.sum()} limits {far / limits.sum():.2%} lie beyond {_FAR:g} combined"
            f" errors, the farthest at {farthest:.2f}; the root mean square is {rms:.2f}."
        )
    page = Page(
        "Designs",
        _INTRODUCTION,
        _NUTPIE.format(chains=f"4 chains of {_DRAWS:,}", seconds=_SAMPLING, counted=counted),
        f"{len(rows) - len(failed)} of {len(rows)} fits pass the gate"
        + (f"; not {', '.join(failed)}." if failed else "."),
        right=not failed,
    )
    heads = ["design", "seed", "processor, s", "wall, s", "memory, MB", "steps", "error", "passed"]
    heads += ["nutpie, s", "divergences", "nutpie's error / percept's", "rms apart", "farthest"]
    heads += ["limits", "beyond 3"]
    page.table(heads, [list(asdict(row).values()) for row in rows])
    return page
