"""Run time against error on a few studies: percept next to plain emcee and nutpie.

Errors are measured against limits pooled over long runs of percept. Their check is another density
by another sampler: the page shows how far nutpie's limits lie from them.

``python -m reports.benchmark.peers TASK`` is the process of one engine: a first run from the start
of the process, then runs of every budget. It prints JSON.
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError, UsageError
from percept.results.plain import plain
from reports.benchmark.measure import Printed, in_a_process, print_result, processor_seconds
from reports.benchmark.simulated import DESIGNS, simulated
from reports.command import say
from reports.store import store

if TYPE_CHECKING:
    # What these need would count as the start of every engine's process.
    from percept.inference.model.interval_estimands import IntervalEstimands
    from percept.inference.model.model import Model
    from percept.study.prepare import Prepared

Array: TypeAlias = NDArray[np.float64]

#: Studies compared, and what each is. All but the published one are simulated.
STUDIES = {
    "published": "10 subjects, 5 environments, one trial; k and b",
    "published-k": "10 subjects, 5 environments, one trial; k alone",
    "24x12x3-weak": (
        "24 subjects, 12 environments, 3 trials; scatter between subjects a fifth of the trials'"
    ),
    "20x100x1": "20 subjects, 100 environments, one trial; k and b",
}
_KINDS = ("mean", "user", "share")
_MOST_STEPS = 2_000_000  # Of percept, so that only its tolerance ends a run
_RUNS = 30  # Behind a reference, of this tolerance: the pool's error is a fifth of that
_REFERENCE_TOLERANCE = 0.005
_WALKERS = 256  # Of emcee, where the coordinates do not ask for more
_KEPT_EVERY = 10  # Steps of emcee
_BURN_IN = 0.25  # Of emcee's steps
_NUTPIE_TUNE = 400  # As its users take it
_LEVEL = 0.01  # Error over half-width that engines are compared at
_RATIO = 2.0  # Time goes with the error to this power, once a sampler has converged


@dataclass(frozen=True, eq=False)
class Fitted:
    """One run of an engine: limits on the response scale, and what it took."""

    value: Array  # (3, 2, C) Kinds, lower and upper, cells (parameter-major)
    error: Array  # (3, 2, C) Monte Carlo standard errors
    effective: float  # Effective draws of the slowest quantity behind them
    seconds: float  # Wall time of sampling and of the limits, without compiling


#: Samples within a budget, in the engine's own unit, from a seed.
Sampler: TypeAlias = Callable[[float, int], Fitted]


def study_of(name: str) -> Prepared:
    """Return one of `STUDIES`."""
    if not name.startswith("published"):
        return simulated(DESIGNS[name], 1)
    from percept.scene import Scene
    from percept.sessions import read_sessions
    from percept.study.data import Data
    from percept.study.prepare import prepare
    from reports import dataset

    parameters = ("k",) if name == "published-k" else ("k", "b")
    sessions = read_sessions(dataset("hbfd_sessions.csv"))
    return prepare(Data(sessions, Scene()), parameters)


def _limits_of(model: Model) -> IntervalEstimands:
    """Return the limits compared."""
    from percept.inference.model.interval_estimands import IntervalEstimands
    from reports.benchmark.nutpie import CONFIDENCE, LEVEL, SHARE

    return IntervalEstimands(model, kinds=_KINDS, level=LEVEL, share=SHARE, confidence=CONFIDENCE)


def percept_run(study: Prepared, tolerance: float, seed: int) -> Fitted:
    """Sample by percept to a tolerance."""
    from percept.inference.sampling.gate import Settings
    from percept.inference.sampling.run import sample

    started = time.perf_counter()
    estimands = _limits_of(study.model)
    settings = Settings(tolerance=tolerance, seed=seed, most_steps=_MOST_STEPS)
    run = sample(study.model, estimands, settings)
    shape = (len(_KINDS), 2, len(estimands.cells))
    value = run.estimates.value.reshape(shape)
    seconds = time.perf_counter() - started
    return Fitted(value, run.errors.reshape(shape), run.gate.effective_draws, seconds)


def _emcee(study: Prepared) -> Sampler:
    """Percept's density and mixture limits, emcee's own moves: what the moves alone cost."""
    import emcee

    from percept.inference.sampling.diagnostics import autocorrelation_time, normal_scores

    model = study.model
    estimands = _limits_of(model)
    shape = (len(_KINDS), 2, len(estimands.cells))
    dimension = len(model.names)
    # emcee refuses an ensemble of fewer.
    walkers = max(_WALKERS, 2 * dimension)

    def fit(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        steps = int(budget)
        points = 0.5 * np.random.default_rng(seed).standard_normal((walkers, dimension))
        sampler = emcee.EnsembleSampler(walkers, dimension, model, vectorize=True)
        # emcee takes nothing but a legacy state here, and ignores the rest in silence.
        random_state = np.random.RandomState(seed).get_state(legacy=True)
        state = emcee.State(points, random_state=random_state)
        sampler.run_mcmc(state, steps, skip_initial_state_check=True)
        chain = np.asarray(sampler.get_chain(discard=int(_BURN_IN * steps), thin=_KEPT_EVERY))
        components = estimands.components(chain.reshape(-1, dimension))
        scores = normal_scores(components.reshape(*chain.shape[:2], -1))
        effective = len(components) / float(autocorrelation_time(scores[None]).max())
        parts = list(estimands.estimates(components))
        value = np.concatenate([estimates.value for estimates, _ in parts])
        sd = np.concatenate([influence.std(axis=0) for _, influence in parts])
        error = (sd / np.sqrt(effective)).reshape(shape)
        return Fitted(value.reshape(shape), error, effective, time.perf_counter() - started)

    return fit


def _nutpie(study: Prepared) -> Sampler:
    from reports.benchmark.nutpie import limits_of_draws, nutpie_sampler, observed, plain_model

    draw = nutpie_sampler(plain_model(observed(study), centred=True), ["beta", "spread"])

    def fit(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        drawn = draw(int(budget), tune=_NUTPIE_TUNE, cores=os.cpu_count(), seed=seed)
        rng = np.random.default_rng(seed)
        limits = limits_of_draws(drawn.values["beta"], drawn.values["spread"], rng)
        return Fitted(*limits, time.perf_counter() - started)

    return fit


@dataclass(frozen=True)
class Engine:
    """One way to sample the model."""

    prepare: Callable[[Prepared], Sampler]
    packages: tuple[str, ...]
    budgets: tuple[tuple[float, int], ...]  # Size and repeats, smallest first

    @property
    def missing(self) -> tuple[str, ...]:
        """Packages that are not installed."""
        return tuple(name for name in self.packages if importlib.util.find_spec(name) is None)


ENGINES = {
    "percept": Engine(
        lambda study: partial(percept_run, study),
        ("percept",),
        ((0.1, 5), (0.02, 5), (0.01, 5), (0.005, 5), (0.002, 3), (0.001, 2)),
    ),
    "emcee": Engine(_emcee, ("emcee",), ((1000, 5), (4000, 5), (16000, 3), (64000, 1))),
    "nutpie": Engine(_nutpie, ("nutpie", "pymc"), ((250, 5), (1000, 15), (4000, 3), (16000, 1))),
}


@dataclass(frozen=True, eq=False)
class Reference:
    """Limits of one study pooled over independent runs."""

    value: Array  # (3, 2, C)
    error: Array  # (3, 2, C)
    scatter: float  # SD of the runs over what each claims

    @classmethod
    def pooled(cls, rows: Sequence[Printed]) -> Self:
        """Pool runs of equal length, each a mapping with value and error."""
        values = np.array([row["value"] for row in rows])
        errors = np.array([row["error"] for row in rows])
        count = len(rows)
        value = values.mean(axis=0)
        claimed = np.sqrt((errors**2).mean(axis=0))
        scatter = math.nan
        if count > 1:
            squares = ((values - value) / claimed) ** 2
            scatter = math.sqrt(squares.sum() / ((count - 1) * value.size))
        return cls(value, claimed / math.sqrt(count), scatter)

    def relative_error(self, value: Array) -> float:
        """Return the root mean square error of limits (3, 2, C) over their half-widths."""
        half_width = 0.5 * (self.value[:, 1:] - self.value[:, :1])
        return float(np.sqrt(np.mean(((value - self.value) / half_width) ** 2)))


def reference_of(name: str, folder: Path, *, runs: int = _RUNS) -> Reference:
    """Pool runs of a study, those that the folder keeps and new ones."""

    def run(seed: int) -> Printed:
        return dict(plain(percept_run(study_of(name), _REFERENCE_TOLERANCE, seed)))

    def tell(done: int, count: int) -> None:
        say(f"{name}: {done} of {count} runs of the reference")

    kept = store(folder, f"{name} {_REFERENCE_TOLERANCE}")
    return Reference.pooled(kept.complete(run, runs, progress=tell))


@dataclass(frozen=True)
class PeerCost:
    """Engines at growing budgets; medians over repeats."""

    study: Annotated[str, "Published, or simulated as subjects x environments x trials."]
    engine: Annotated[
        str,
        "emcee has its stretch moves on percept's density. nutpie has the model written plainly.",
    ]
    size: Annotated[
        float,
        "percept: tolerance. emcee: steps of 256 walkers, or of twice the coordinates. nutpie:"
        " draws of each of 4 chains.",
    ]
    repeats: Annotated[int, "Runs."]
    warm_s: Annotated[float, "Wall time of sampling and limits, s."]
    cold_s: Annotated[float, "The same with the start of the process, s."]
    processor_s: Annotated[float, "Processor time of a warm run, s."]
    error: Annotated[float, "Root mean square of limits less the reference, over half-widths."]
    draws_per_s: Annotated[float, "Effective draws of the slowest quantity per s of a warm run."]
    agreement: Annotated[
        float, "Root mean square of limits less the reference, over the error of both."
    ]


def peer_costs(
    out: Path, *, engines: Sequence[str] = (), studies: Sequence[str] = (), seconds: float = 150.0
) -> list[PeerCost]:
    """Measure installed engines on studies, each in a process of its own.

    Parameters
    ----------
    out : Path
        Folder that keeps the runs behind references.
    engines, studies : sequence of str
        Of `ENGINES` and `STUDIES`; all without names.
    seconds : float
        After which no run of an engine begins.

    Returns
    -------
    list of PeerCost
        Study by study, engine by engine, the smallest budget first.

    Raises
    ------
    UsageError
        For an engine or a study that does not exist.
    RefusalError
        Where no engine asked for is installed.
    """
    for key, chosen, known in (("--engines", engines, ENGINES), ("--rows", studies, STUDIES)):
        for name in chosen:
            if name not in known:
                raise UsageError(f"there are {', '.join(known)}.", key=key, value=name)
    present = []
    for name in engines or ENGINES:
        missing = ENGINES[name].missing
        if missing:
            say(f"{name}: left out, {', '.join(missing)} not installed")
        else:
            present.append(name)
    if not present:
        raise RefusalError(
            "none of these engines is installed.",
            value=", ".join(engines),
            hint="pip install 'percept-haptics[peers]'",
        )
    rows: list[PeerCost] = []
    for study in studies or STUDIES:
        reference = reference_of(study, out)
        say(f"{study}: its reference scatters {reference.scatter:.2f} times what runs claim")
        for name in present:
            say(f"{study}, {name}")
            task = {"engine": name, "study": study, "seconds": seconds, "started": time.time()}
            rows += _reduced(study, name, in_a_process(__name__, task), reference)
    return rows


def _reduced(study: str, name: str, printed: Printed, reference: Reference) -> Iterator[PeerCost]:
    """Yield a row for each budget of an engine."""
    by_size: dict[float, list[Printed]] = {}
    for run in printed["runs"]:
        by_size.setdefault(run["size"], []).append(run)
    smallest = next(iter(by_size.values()))
    # What the first run of a process takes beyond a later one: imports, building and compiling.
    start = max(printed["first"] - median(run["seconds"] for run in smallest), 0.0)
    for size, runs in by_size.items():
        warm = median(run["seconds"] for run in runs)
        values = np.array([run["value"] for run in runs])
        claimed = np.hypot([run["error"] for run in runs], reference.error)
        apart = (values - reference.value) / claimed
        yield PeerCost(
            study=study,
            engine=name,
            size=size,
            repeats=len(runs),
            warm_s=warm,
            cold_s=start + warm,
            processor_s=median(run["processor"] for run in runs),
            error=median(reference.relative_error(value) for value in values),
            draws_per_s=median(run["effective"] for run in runs) / warm,
            agreement=float(np.sqrt(np.mean(apart**2))),
        )


def time_to(level: float, rows: Sequence[PeerCost]) -> tuple[float, bool]:
    """Return an engine's warm time to an error, s, and whether it is extrapolated."""
    enough = [row.warm_s for row in rows if row.error <= level]
    if enough:
        return min(enough), False
    best = min(rows, key=lambda row: row.error)
    return best.warm_s * (best.error / level) ** _RATIO, True


def summary(rows: Sequence[PeerCost]) -> list[str]:
    """Say for each study how long engines take to an error of 1 % of the half-widths."""
    lines = []
    for study in dict.fromkeys(row.study for row in rows):
        times = []
        for name in dict.fromkeys(row.engine for row in rows if row.study == study):
            own = [row for row in rows if (row.study, row.engine) == (study, name)]
            seconds, extrapolated = time_to(_LEVEL, own)
            times.append(f"{name} {seconds:.3g} s{' (extrapolated)' if extrapolated else ''}")
        lines.append(f"{study} ({STUDIES[study]}), to an error of 1 %: {', '.join(times)}.")
    return lines


def _main(text: str) -> None:
    """Run an engine as its task says and print what it gave."""
    task = json.loads(text)
    # Samplers warn about runs as short as some of these are meant to be.
    warnings.simplefilter("ignore")
    began = time.time()
    study = study_of(task["study"])
    # Reading is the same for all engines, and no part of any of them.
    read = time.time() - began
    engine = ENGINES[task["engine"]]
    sampler = engine.prepare(study)
    seed = 1
    smallest, _ = engine.budgets[0]
    sampler(smallest, seed)
    first = time.time() - task["started"] - read
    runs: list[Printed] = []
    for size, repeats in engine.budgets:
        for _ in range(repeats):
            if runs and time.time() - task["started"] > task["seconds"]:
                break
            seed += 1
            before = processor_seconds()
            fitted = asdict(sampler(size, seed))
            runs.append({"size": size, "processor": processor_seconds() - before, **fitted})
    print_result({"first": first, "runs": runs})


if __name__ == "__main__":
    _main(sys.argv[1])
