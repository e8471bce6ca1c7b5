"""Reference limits: long runs of percept's own moves, and of emcee's differential evolution beside them."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any, Self, TypeAlias

import numpy as np

from percept.bench.peers.engines import percept_model
from percept.bench.peers.model import KINDS, Array
from percept.errors import RefusalError
from percept.inference.hierarchy.models import IntervalEstimands, Model
from percept.inference.sampling.diagnostics import autocorrelation_time, monte_carlo_error, normal_scores
from percept.inference.sampling.moves import advance, start
from percept.inference.sampling.warmup import warm_up

#: Kept positions (E, T, W, d), and the steps between them.
Kept: TypeAlias = tuple[Array, int]
#: Draws from a model.
Sampler: TypeAlias = Callable[[Model, np.random.SeedSequence], Kept]
_ENSEMBLES, _WALKERS = 4, 128
#: Steps dropped, steps kept, and steps between kept positions, of one run.
_OWN = (120, 2400, 12)
_OTHER = (1200, 3200, 20)


@dataclasses.dataclass(frozen=True, eq=False)
class LongRun:
    """Limits pooled over independent runs."""

    value: Array  # (3, 2, C)
    error: Array  # (3, 2, C)
    effective: float  # Effective draws of the slowest quantity, over all runs
    runs: int  # Runs pooled
    scatter: float  # SD of the runs over what each claims

    @classmethod
    def pooled(cls, rows: list[dict[str, Any]]) -> Self:
        """Pool runs of equal length, each a mapping with value, error and effective."""
        values = np.array([row["value"] for row in rows])
        errors = np.array([row["error"] for row in rows])
        count = len(rows)
        value, claimed = values.mean(axis=0), np.sqrt((errors**2).mean(axis=0))
        spread = (values - value) / claimed
        scatter = math.sqrt((spread**2).sum() / ((count - 1) * value.size)) if count > 1 else math.nan
        effective = sum(row["effective"] for row in rows)
        return cls(value, claimed / math.sqrt(count), effective, count, scatter)


@dataclasses.dataclass(frozen=True, eq=False)
class Reference:
    """What errors are measured against."""

    own: LongRun  # percept's own moves
    other: LongRun  # emcee's differential evolution on the same density
    cells: tuple[tuple[str, str], ...]  # (parameter, environment), parameter-major
    sessions_sha256: str  # Of the session file the limits belong to
    command: str  # What makes it

    @property
    def half_width(self) -> Array:
        """Half-widths of the intervals, shape (3, 1, C)."""
        return 0.5 * (self.own.value[:, 1:] - self.own.value[:, :1])

    @property
    def apart(self) -> Array:
        """Difference of the two runs over its standard error, shape (3, 2, C)."""
        return (self.other.value - self.own.value) / np.hypot(self.own.error, self.other.error)

    def relative_error(self, value: Array) -> float:
        """Root mean square error of limits (3, 2, C) over their half-widths."""
        return float(np.sqrt(np.mean(((value - self.own.value) / self.half_width) ** 2)))

    @classmethod
    def of_json(cls, stored: dict[str, Any]) -> Self:
        """Undo `percept.report.plain`."""
        own, other = (
            LongRun(**(stored[key] | {name: np.array(stored[key][name]) for name in ("value", "error")}))
            for key in ("own", "other")
        )
        cells = tuple((str(p), str(e)) for p, e in stored["cells"])
        return cls(own, other, cells, stored["sessions_sha256"], stored["command"])


def stored_reference(sessions_sha256: str) -> Reference:
    """Return the reference that comes with percept."""
    text = resources.files("percept.bench.peers").joinpath("reference.json").read_text(encoding="utf-8")
    found = Reference.of_json(json.loads(text))
    if found.sessions_sha256 != sessions_sha256:
        raise RefusalError(
            "the stored reference limits belong to another session file.",
            value=sessions_sha256,
            hint="Make them again: percept bench reference --out DIR.",
        )
    return found


def make_reference(
    source: str,
    sessions_sha256: str,
    work: Path,
    *,
    command: str,
    own_effective: float = 1e6,
    other_effective: float = 1e5,
    log: Callable[[str], None] = lambda line: None,
) -> Reference:
    """Run both samplers until there are enough effective draws; an interrupted call goes on."""
    model, estimands = percept_model(source)
    runs = {}
    for name, sampler, wanted in (("other", _other, other_effective), ("own", _own, own_effective)):
        rows: list[dict[str, Any]] = []
        for row in _rows(work / f"{name}-{sessions_sha256[:12]}.jsonl", model, estimands, sampler):
            rows.append(row)
            effective = sum(one["effective"] for one in rows)
            log(f"{name}: run {len(rows)}, {effective:.0f} of {wanted:.0f} effective draws")
            if effective >= wanted and len(rows) > 1:
                break
        runs[name] = LongRun.pooled(rows)
    return Reference(runs["own"], runs["other"], estimands.cells, sessions_sha256, command)


def _rows(
    path: Path, model: Model, estimands: IntervalEstimands, sampler: Sampler
) -> Iterator[dict[str, Any]]:
    """Finished runs first, then new ones, each written before it is used."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    yield from map(json.loads, lines)
    for seed in itertools.count(len(lines) + 1):
        row = _limits(estimands, *sampler(model, np.random.SeedSequence([20240501, seed])))
        with path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row) + "\n")
        yield row


def _limits(estimands: IntervalEstimands, kept: Array, stride: int) -> dict[str, Any]:
    """Limits of one run from its kept positions (E, T, W, d)."""
    components = estimands.components(kept.reshape(-1, kept.shape[-1]))
    estimates, influence = estimands.estimate(components)
    influence = influence.reshape(*kept.shape[:3], -1)
    scores = normal_scores(components).reshape(*kept.shape[:3], -1)
    times = autocorrelation_time(influence)
    slowest = max(float(times.max()), float(autocorrelation_time(scores).max()))
    shape = (len(KINDS), 2, len(estimands.cells))
    return {
        "value": estimates.value.reshape(shape).tolist(),
        "error": monte_carlo_error(influence, times).reshape(shape).tolist(),
        "effective": len(components) / slowest,
        "autocorrelation_time": slowest * stride,
    }


def _own(model: Model, seed: np.random.SeedSequence) -> Kept:
    warm, moves = seed.spawn(2)
    dropped, steps, stride = _OWN
    here, points = warm_up(model, (_ENSEMBLES, _WALKERS), warm)
    state, _ = advance(here, start(here, points, moves), steps=dropped, stride=dropped)
    kept = advance(here, state, steps=steps, stride=stride)[1]
    return here.map(kept.reshape(-1, kept.shape[-1])).reshape(kept.shape), stride


def _other(model: Model, seed: np.random.SeedSequence) -> Kept:
    import emcee

    rng = np.random.default_rng(seed)
    dropped, steps, stride = _OTHER
    size = len(model.names)
    chains = []
    for _ in range(_ENSEMBLES):
        sampler = emcee.EnsembleSampler(_WALKERS, size, model, moves=emcee.moves.DEMove(), vectorize=True)
        mersenne = np.random.RandomState(rng.integers(2**32)).get_state(legacy=True)
        state = emcee.State(0.5 * rng.standard_normal((_WALKERS, size)), random_state=mersenne)
        sampler.run_mcmc(state, dropped + steps, skip_initial_state_check=True)
        chains.append(sampler.get_chain(discard=dropped + stride - 1, thin=stride))
    return np.stack(chains), stride
