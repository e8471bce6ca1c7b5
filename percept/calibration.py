"""Real coverage of every kind and method: simulate studies like one, refit, count."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.checkpoint import Checkpoint, Line, plan_digest
from percept.errors import RefusalError, UsageError
from percept.judge import CoveragePlan, Family, Held, Labels, Method, judge_study
from percept.provenance import markdown_table
from percept.scene import Scene
from percept.sessions.quantities import is_impedance
from percept.simulate import Design, Hyperparameters, TrueValues
from percept.study import Study
from percept.study.responses import refuse_no_ratio
from percept.workers import Mapper, in_process

# Of the posterior, what `Hyperparameters` holds; trials have no law over environments there.
_HYPER_SCALES = ("tau", "sigma_u", "s", "kappa", "omega", "omega_s")
_CORRELATIONS = ("rho_u", "rho_w", "rho_e")
# Tolerance of simulated fits: the error of a limit hardly moves what it covers, and time counts.
_TOLERANCE = 0.05
# Device of a study without a known one (kg, N·s/m, s), and frequencies (rad/s).
_DEVICE = {"mass": 1.0, "damping": 5.0, "period": 0.001}
_FREQUENCY = {"lower": 0.1, "upper": 100.0, "points": 11}


def refuse_unfit(study: Study) -> None:
    """Refuse a study whose like cannot be simulated, before anything is sampled.

    Parameters
    ----------
    study : Study
        The study.

    Raises
    ------
    RefusalError
        More than two quantities, or a reference that no response is a ratio to.
    """
    if len(study.data.parameters) > 2:
        raise RefusalError(
            "calibration simulates one quantity or two together.",
            hint="Name them in [inference] parameters.",
        )
    refuse_no_ratio(
        study.data.reference,
        study.sessions.quantities,
        why="and simulated responses are ratios to it",
    )


def fitted_values(study: Study) -> TrueValues:
    """Take the posterior means of a study as the truth to simulate from.

    Parameters
    ----------
    study : Study
        A study with a Bayesian fit that passed.

    Returns
    -------
    TrueValues
        Environments in the order of the study.

    Raises
    ------
    RefusalError
        There is no such fit, or its like cannot be simulated.
    """
    refuse_unfit(study)
    fit = study.fit
    if fit is None or not fit.passed or fit.trials is None:
        raise RefusalError(
            "calibration needs a passed Bayesian fit of the sessions.",
            hint='Set method = "both" and pooling = "partial", or calibrate from the prior.',
        )
    model = fit.model
    points = fit.points
    cells = model.moments(points).mean.mean(axis=0)
    means = {name: values.mean(axis=0) for name, (_, values) in model.scales(points).items()}
    beta = cells.reshape(len(study.data.parameters), -1).T
    shared: dict[str, Any] = {name: means[name] for name in _HYPER_SCALES if name in means}
    if "sigma_v:trend" in means:
        shared["sigma_trend"] = means["sigma_v:trend"]
        shared["rho_trend"] = float(np.mean(means.get("rho_v:trend", 0.0)))
    for name in _CORRELATIONS:
        if name in means:
            shared[name] = float(means[name].mean())
    return TrueValues(
        hyper=Hyperparameters(alpha=beta.mean(axis=0), **shared),
        beta=beta,
        sigma=means["sigma"].T,
        # With one trial a cell the scatter between trials is part of what a user's value is.
        sigma_e=means.get("sigma_e", np.zeros_like(beta.T)).T,
    )


def plan_like(
    study: Study,
    subjects: int | None = None,
    *,
    method: Method = "both",
    users_family: Family = "lognormal",
    values: TrueValues | None = None,
) -> CoveragePlan:
    """Plan studies of this one's environments and settings.

    Parameters
    ----------
    study : Study
        The study.
    subjects : int, optional
        Subjects with a trial each; the study's own subjects and trials by default.
    method : {"both", "classical", "bayesian"}
        Which methods are judged.
    users_family, values
        As `CoveragePlan` has them.

    Returns
    -------
    CoveragePlan
    """
    design = _design_of(study)
    if subjects not in (None, len(design.trials)):
        design = replace(design, trials=np.ones((subjects, len(design.references)), dtype=int))
    model: dict[str, Any] = {}
    if values is None or not np.any(values.hyper.omega_s):
        # Subjects have trial SDs of their own only if they truly do.
        model["subjects_trial_sd"] = False
    asked = study.scene.inference
    if is_impedance(design.parameters):
        own = study.scene.device
        known = own is not None and own.mass is not None and own.damping is not None
        device = {name: getattr(own, name) for name in _DEVICE} if known else _DEVICE
        described: dict[str, Any] = {"device": device}
    else:
        quantities = study.sessions.quantities
        described = {
            "quantities": {
                parameter: quantities[parameter].model_dump(exclude={"name"})
                for parameter in design.parameters
            }
        }
    inference = asked.model_dump(include={"level", "share", "confidence", "family", "seed"})
    inference |= {"method": method, "tolerance": max(asked.tolerance, _TOLERANCE)}
    scene = Scene(**described, frequency=_FREQUENCY, model=model, inference=inference)
    return CoveragePlan(design=design, scene=scene, users_family=users_family, values=values)


def _design_of(study: Study) -> Design:
    """Return who adjusted what in a study, and how often."""
    data = study.data
    references = [
        [data.reference[parameter, environment] for parameter in data.parameters]
        for environment in data.environments
    ]
    table = study.sessions.table
    # Published limits have no subjects: `plan_like` is told how many.
    counts = pd.crosstab(table.get("subject", table["environment"]), table["environment"])
    counts = counts.reindex(index=study.sessions.subjects, columns=data.environments)
    return Design(np.array(references), counts.to_numpy(), data.parameters, data.environments)


def coverage(
    plan: CoveragePlan,
    studies: int,
    *,
    mapper: Mapper = in_process,
    checkpoint: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """Simulate and judge studies, and average.

    Parameters
    ----------
    plan : CoveragePlan
        The studies.
    studies : int
        How many, at least two.
    mapper : Mapper
        The workers.
    checkpoint : str or Path, optional
        File that keeps judged studies, so that an interrupted run goes on.
    progress : callable, optional
        Told how many studies are finished, and of how many.

    Returns
    -------
    DataFrame
        As `averaged` gives it.

    Raises
    ------
    UsageError
        Fewer than two studies, or the checkpoint holds something else.
    """
    if studies < 2:
        raise UsageError(
            "a standard error needs at least two studies.", key="studies", value=studies
        )
    judge = functools.partial(_judged_line, plan)
    path = None if checkpoint is None else Path(checkpoint)
    kept = Checkpoint(path, plan_digest(plan), what="judged")
    lines = kept.complete(judge, studies, mapper=mapper, progress=progress)
    judged = [{Labels(*labels): held for *labels, held in line["judged"]} for line in lines]
    return averaged(plan, judged)


def _judged_line(plan: CoveragePlan, index: int) -> Line:
    """Judge a study; give each claim as a list of its labels and how far it held."""
    return {"judged": [[*labels, held] for labels, held in judge_study(plan, index).items()]}


def averaged(plan: CoveragePlan, judged: Sequence[Held]) -> pd.DataFrame:
    """Average what became of each claim over studies.

    Parameters
    ----------
    plan : CoveragePlan
        The studies.
    judged : sequence of Held
        The claims of each study.

    Returns
    -------
    DataFrame
        A row per claim. `stated` is the level, or the confidence for kind share. `held` is the mean
        fraction that was true, `error` its standard error, `studies` how many it rests on.
        "withheld" and "refused" count among all studies.
    """
    fractions: dict[Labels, list[float]] = {}
    for claims in judged:
        for labels, value in claims.items():
            fractions.setdefault(labels, []).append(value)
    rows = []
    for labels, values in fractions.items():
        held = np.array(values)
        stated = plan.asked.confidence if labels.kind == "share" else plan.asked.level
        if labels.claim in ("withheld", "refused"):
            stated = math.nan
            held = np.append(held, np.zeros(len(judged) - held.size))
        rows.append(
            {
                **labels._asdict(),
                "subjects": len(plan.design.trials),
                "truth": plan.users_family,
                "stated": stated,
                "held": held.mean(),
                "error": _standard_error(held),
                "studies": held.size,
            }
        )
    return pd.DataFrame(rows)


def _standard_error(held: NDArray[np.float64]) -> float:
    """Return the standard error of a mean over studies; NaN of fewer than two.

    Six studies of six that hold do not make a coverage certain: studies that all agree count as
    with half a study more for and half a study more against.
    """
    if held.size < 2:
        return math.nan
    if np.ptp(held) > 0:
        return float(held.std(ddof=1) / np.sqrt(held.size))
    rate = (held.sum() + 0.5) / (held.size + 1.0)
    return float(np.sqrt(rate * (1.0 - rate) / (held.size + 1.0)))


def coverage_markdown(rows: pd.DataFrame) -> str:
    """Write coverage as a table in Markdown: each figure with its standard error, in per cent.

    Parameters
    ----------
    rows : DataFrame
        As `averaged` gives it.

    Returns
    -------
    str
    """
    heads = [*Labels._fields, "users", "n", "stated", "real", "±", "studies"]
    lines = []
    for row in rows.to_dict("records"):
        stated = "" if math.isnan(row["stated"]) else f"{100 * row['stated']:g} %"
        held = f"{100 * row['held']:.2f} %"
        error = "–" if math.isnan(row["error"]) else f"{100 * row['error']:.2f}"
        cells = [row[name] for name in (*Labels._fields, "truth", "subjects")]
        lines.append([*cells, stated, held, error, row["studies"]])
    return markdown_table(heads, lines)
