"""One simulated study, refitted: how much of what each interval and boundary claims is true."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.boundary.records import Boundary
from percept.calibration.plan import CoveragePlan
from percept.calibration.truth import Population, populations_of
from percept.errors import RefusalError
from percept.haptics import Device, perceived_magnitude
from percept.inference.hierarchy.priors import Priors
from percept.scene import Scene
from percept.sessions import Sessions
from percept.simulate.design import Design
from percept.simulate.model import TrueValues, draw_environments, draw_hyperparameters
from percept.simulate.study import simulate
from percept.study import Study
from percept.study.prediction import predict
from percept.study.regions import displayable

Array = NDArray[np.float64]
_USERS = 200
_NAMES = ("k", "b")
_Key = tuple[str, str, str, str, str, str]


@dataclasses.dataclass(frozen=True)
class Judgement:
    """What became of one claim in one study."""

    claim: str
    kind: str  # Of the interval or boundary
    method: str  # Of the interval or boundary
    family: str  # Of the interval or boundary
    joint: str  # Of the interval or boundary
    shape: str  # Of the interval or boundary
    held: float  # Share of the environments and parameters (and users, frequencies) for which it was true


def judge_study(plan: CoveragePlan, index: int) -> list[Judgement]:
    """Simulate study number `index` of a plan, analyse it, and judge every claim."""
    rng = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(index,)))
    study, populations = _simulated(plan, rng)
    found = []
    try:
        if study.fit is not None and not study.fit.run.gate.passed:
            found.append(Judgement("withheld", "", "bayesian", plan.family, "", "", 1.0))
    except RefusalError:
        found.append(Judgement("refused", "", "bayesian", plan.family, "", "", 1.0))
        study = Study(study.sessions, study.scene.with_inference(method="classical"))
    known = dict(zip(study.environments, populations, strict=False))
    claims = [
        _Claim("interval", row, _interval_held(row, known[row["environment"]]))
        for row in _records(study.intervals)
    ]
    claims += _judged_boundaries("boundary", study.boundaries, known, study, rng)
    if plan.held_out is not None and study.fit is not None and study.fit.run.gate.passed:
        claims += _judged_prediction(plan, study, populations[-1], rng)
    return found + _averaged(claims)


@dataclasses.dataclass(frozen=True)
class _Claim:
    claim: str
    what: dict[str, Any]
    held: float


def _averaged(claims: list[_Claim]) -> list[Judgement]:
    """Mean over environments and parameters: within one study they are not independent."""
    groups: dict[_Key, list[float]] = {}
    for one in claims:
        kind, method, family, joint = (str(one.what[n]) for n in ("kind", "method", "family", "joint"))
        key = (one.claim, kind, method, family, joint, str(one.what.get("shape", "")))
        groups.setdefault(key, []).append(one.held)
    return [Judgement(*key, float(np.mean(held))) for key, held in groups.items()]


def _simulated(plan: CoveragePlan, rng: np.random.Generator) -> tuple[Study, list[Population]]:
    tested = np.array(plan.references)
    every = tested if plan.held_out is None else np.vstack([tested, plan.held_out])
    design = Design.balanced(every, subjects=plan.subjects)
    values = plan.true_values() or _from_prior(design, tested, rng)
    simulated = simulate(design, seed=rng, values=values, family=plan.truth)
    kept = simulated.table[simulated.table["environment"].isin(design.environments[: len(tested)])]
    lower, upper, points = plan.frequencies
    scene = Scene.from_tables(
        {
            "device": {"mass": plan.device[0], "damping": plan.device[1], "period": plan.period},
            "frequency": {"lower": lower, "upper": upper, "points": points},
            "inference": {
                "level": plan.level,
                "share": plan.level if plan.share is None else plan.share,
                "confidence": plan.confidence,
                "family": plan.family,
                "method": plan.method,
                "tolerance": plan.tolerance,
                "seed": int(rng.integers(1 << 31)),
            },
        }
    )
    study = Study(Sessions.from_frame(kept.drop(columns="source")), scene)
    return study, populations_of(simulated.truth, every, plan.truth)


def _from_prior(design: Design, tested: Array, rng: np.random.Generator) -> TrueValues:
    """Draw from the priors as the analysis knows them: decades about the tested references only."""
    priors = Priors()
    hyper = draw_hyperparameters(design, priors, rng)
    shift = np.log10(design.references).mean(axis=0) - np.log10(tested).mean(axis=0)
    about_all = dataclasses.replace(
        hyper, alpha=hyper.alpha + hyper.gamma * shift, s=hyper.s * np.exp(hyper.kappa * shift)
    )
    return draw_environments(about_all, design, rng)


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]


def _interval_held(row: dict[str, Any], users: Population) -> float:
    p, lower, upper = _NAMES.index(row["parameter"]), row["lower"], row["upper"]
    if row["kind"] == "mean":
        return float(lower <= users.average(row["family"])[p] <= upper)
    content = users.content(p, lower, upper)
    return content if row["kind"] == "user" else float(content >= row["share"])


def _judged_boundaries(
    claim: str,
    boundaries: tuple[Boundary, ...],
    known: dict[str, Population],
    study: Study,
    rng: np.random.Generator,
) -> Iterator[_Claim]:
    table = study.scene.device
    assert table is not None
    assert isinstance(study.device, Device)
    users = {environment: population.users(_USERS, rng) for environment, population in known.items()}
    for boundary in boundaries:
        if boundary.kind == "share" or boundary.shape == "corner":
            continue
        population = known[boundary.environment]
        if boundary.kind == "mean":
            points = population.average(boundary.family)[None]  # type: ignore[arg-type]
        else:
            points = users[boundary.environment]
        points = displayable(points)
        curves = perceived_magnitude(
            boundary.omega[:, None], study.device, points[:, 0], points[:, 1], table.period
        )
        inside = (boundary.lower[:, None] <= curves) & (curves <= boundary.upper[:, None])
        what = {name: getattr(boundary, name) for name in ("kind", "method", "family", "joint", "shape")}
        yield _Claim(f"{claim} at an omega", what, float(inside.mean()))
        yield _Claim(f"{claim} throughout", what, float(inside.all(axis=0).mean()))


def _judged_prediction(
    plan: CoveragePlan, study: Study, users: Population, rng: np.random.Generator
) -> Iterator[_Claim]:
    assert plan.held_out is not None
    k, b = plan.held_out
    predicted = predict(study, stiffness=k, damping=b)
    for row in _records(predicted.intervals):
        yield _Claim("prediction", row, _interval_held(row, users))
    known = {predicted.environment: users}
    yield from _judged_boundaries("predicted boundary", predicted.boundaries, known, study, rng)
