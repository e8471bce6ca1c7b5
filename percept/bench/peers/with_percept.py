"""percept itself: sampled to a tolerance; limits from the mixture and from raw draws."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from percept.bench.peers.endpoints import CONFIDENCE, KINDS, LEVEL, SHARE, Limits, limits_of_draws
from percept.bench.peers.engines import Fitted, Sampler
from percept.bench.peers.responses import Responses
from percept.inference.hierarchy.density import ConditionalMoments
from percept.inference.hierarchy.models import IntervalEstimands, Model
from percept.inference.sampling.records import Run, Settings
from percept.inference.sampling.run import sample

Array = NDArray[np.float64]
_MOST_STEPS = 2_000_000


class StudyEstimands(IntervalEstimands):
    """The limits compared, with the model they belong to."""

    def __init__(self, model: Model) -> None:
        super().__init__(model, kinds=KINDS, level=LEVEL, share=SHARE, confidence=CONFIDENCE)
        self.model = model


def estimands_of(source: str) -> StudyEstimands:
    """Read sessions and build percept's model of them with its default priors."""
    from percept.scene import Scene
    from percept.sessions import read_sessions
    from percept.study.bayesian import prepare as build

    return StudyEstimands(build(read_sessions(source), Scene(), ("k", "b")).model)


def limits_of_mixture(estimands: IntervalEstimands, components: Array, effective: float) -> Limits:
    """Roots of the mixture over draws, with errors from the draws' influences."""
    found, influence = estimands.estimate(components)
    shape = (len(KINDS), 2, len(estimands.cells))
    error = influence.std(axis=0) / np.sqrt(effective)
    return Limits(found.value.reshape(shape), error.reshape(shape), effective)


def limits_of_raw(run: Run, seed: int) -> Limits:
    """Quantiles of one conditional draw of the locations per kept draw of the scales."""
    points = run.points.reshape(-1, run.points.shape[-1])
    laws = ConditionalMoments.unpack(run.components.reshape(len(points), -1))
    rng = np.random.default_rng(seed)
    beta = laws.mean + laws.sd * rng.standard_normal(laws.mean.shape)
    found = limits_of_draws(beta[None], laws.population_sd[None], rng)
    return Limits(found.value, found.error, run.gate.effective_draws)


def prepare(study: Responses, source: str) -> Sampler:
    """Read the study and make the density."""
    del study
    estimands = estimands_of(source)

    def fit(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        settings = Settings(tolerance=budget, seed=seed, most_steps=_MOST_STEPS)
        run = sample(estimands.model, estimands, settings)
        seconds = time.perf_counter() - started
        shape = (len(KINDS), 2, len(estimands.cells))
        gate = run.gate
        mixture = Limits(run.estimates.value.reshape(shape), run.errors.reshape(shape), gate.effective_draws)
        notes = {
            "passed": float(gate.passed), "worst_error": gate.worst_error, "steps": float(run.steps),
            "autocorrelation_time": gate.autocorrelation_time, "acceptance": gate.acceptance,
        }  # fmt: skip
        return Fitted({"mixture": mixture, "draws": limits_of_raw(run, seed)}, seconds, notes)

    return fit
