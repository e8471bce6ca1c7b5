"""Real coverage of every kind and method: simulate studies, refit, count; and the method it recommends."""

from __future__ import annotations

import functools
import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.calibration.judge import EACH, LABELS, CoveragePlan, judge_study
from percept.calibration.studies import Checkpoint
from percept.errors import RefusalError, UsageError
from percept.files import write_whole
from percept.inference.hierarchy.density import CollapsedDensity
from percept.sessions.quantities import Quantities
from percept.study import Study
from percept.study.intervals import cell_moments, known_moments
from percept.study.responses import refuse_no_ratio
from percept.workers import Mapper

#: Studies needed of the Bayesian and of the classical method, under either truth, before any is
#: recommended.
STUDIES = 300, 10_000
FILE, TRUTH = "advice.csv", "truth.json"
_COUNTED = ["subjects", "truth", "stated", "held", "error", "studies"]
#: Standard errors by which coverage must miss the stated level to count as below it.
_ERRORS = 2.0
_USERS = "users of the fitted model", "normal users"
_METHODS = {"bayesian": "Bayesian", "classical": "classical"}
_THEORY = (
    "Which to use: for normal users the classical intervals cover exactly what they state. The"
    " Bayesian ones cover it on average over their priors."
)


def refuse_unfit(study: Study) -> None:
    """Refuse a study whose like cannot be simulated, before anything is sampled."""
    if len(study.parameters) > 2:
        raise RefusalError(
            "calibration simulates one quantity or two together.",
            hint="Name them in [inference] parameters.",
        )
    refuse_no_ratio(
        study.reference, study.sessions.quantities, why="and simulated responses are ratios to it"
    )


def fitted_values(study: Study) -> dict[str, Any]:
    """Take the posterior means of a study as the truth to simulate from."""
    refuse_unfit(study)
    fit = study.fit
    if fit is None or not fit.passed or not isinstance(fit.model, CollapsedDensity):
        raise RefusalError(
            "calibration needs a passed Bayesian fit of the sessions.",
            hint='Set method = "both" and pooling = "partial", or calibrate from the prior.',
        )
    model = fit.model
    points = fit.points
    means = {name: values.mean(axis=0) for name, (_, values) in model.scales(points).items()}
    beta = model.laws(points).mean.mean(axis=0).reshape(len(study.parameters), -1).T
    zero = [0.0] * len(study.parameters)
    hyper: dict[str, Any] = {"alpha": beta.mean(axis=0).tolist(), "gamma": zero}
    for name in ("tau", "sigma_u", "s", "kappa", "omega"):
        hyper[name] = means[name].tolist() if name in means else zero
    for name in ("rho_u", "rho_w", "rho_e"):
        hyper[name] = float(means[name].mean()) if name in means else 0.0
    hyper |= {"s_e": zero, "kappa_e": zero, "omega_e": zero}
    return {
        "hyper": hyper,
        "delta": (beta - beta.mean(axis=0)).tolist(),
        "beta": beta.tolist(),
        "sigma": means["sigma"].T.tolist(),
        # With one trial a cell the scatter between trials is part of what a user's value is.
        "sigma_e": means.get("sigma_e", np.zeros_like(beta.T)).T.tolist(),
    }


def kept_values(study: Study, folder: Path) -> dict[str, Any]:
    """Take the fitted values that an interrupted run left in a folder, or fit them and leave them there.

    Studies are kept by their truth: another fit's Monte Carlo error would make it another plan.
    """
    table = study.sessions.table.to_csv() + json.dumps(
        study.scene.to_dict(), sort_keys=True, default=str
    )
    digest, path = hashlib.sha256(table.encode()).hexdigest(), folder / TRUTH
    kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if kept.get("study") == digest:
        return dict(kept["values"])
    values = fitted_values(study)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(path, json.dumps({"study": digest, "values": values}, indent=1).encode())
    return values


def own_values(study: Study, fitted: dict[str, Any]) -> dict[str, Any]:
    """Take the mean and SD of every cell as the truth of normal users, and the fitted trial noise."""
    known = known_moments(cell_moments(study.sessions, study.parameters, "normal"), "normal")
    if missing := [
        f"{study.sessions.quantities[p].label} in {e}"
        for p, e in study.reference
        if (p, e) not in known
    ]:
        raise RefusalError(f"{missing[0]} has no mean and SD of its own to simulate from.")
    counts = study.sessions.table.groupby(["environment", "subject"], sort=False).size()
    of_mean = (1.0 / counts).groupby("environment", sort=False).mean().to_numpy()[:, None]
    cells = [
        [(known[p, e], study.reference[p, e]) for p in study.parameters] for e in study.environments
    ]
    mean, sd = (
        np.array([[float(getattr(m, name)) / reference for m, reference in row] for row in cells])
        for name in ("mean", "sd")
    )
    # Chance can leave less scatter between subjects than their trials explain.
    sigma = np.sqrt(np.maximum(sd**2 - of_mean * np.square(fitted["sigma_e"]), 0.01 * sd**2))
    hyper = {
        n: 0.0 if np.isscalar(value) else [0.0] * len(value) for n, value in fitted["hyper"].items()
    }
    beta = (mean - 1.0).tolist()
    return fitted | {"hyper": hyper, "delta": beta, "beta": beta, "sigma": sigma.tolist()}


def plan_like(study: Study, subjects: int | None = None, **changes: Any) -> CoveragePlan:
    """Plan studies of this one's environments and settings, and of its subjects and trials if not told."""
    inference, device, table = study.scene.inference, study.scene.device, study.sessions.table
    if device is not None and device.mass is not None and device.damping is not None:
        changes |= {"device": (device.mass, device.damping), "period": device.period}
    if subjects in (None, len(study.sessions.subjects)):
        counts = pd.crosstab(table["subject"], table["environment"])
        counts = counts.loc[list(study.sessions.subjects), list(study.environments)]
        changes["trials"] = tuple(map(tuple, counts.to_numpy().tolist()))
    return CoveragePlan(
        references=tuple(
            tuple(study.reference[p, e] for p in study.parameters) for e in study.environments
        ),
        parameters=study.parameters,
        quantities={
            p: study.sessions.quantities[p].model_dump(exclude={"name"}) for p in study.parameters
        },
        environments=study.environments,
        subjects=subjects or len(study.sessions.subjects),
        family=inference.family,
        level=inference.level,
        share=inference.held_share,
        confidence=inference.confidence,
        tolerance=max(inference.tolerance, 0.05),
        seed=inference.seed,
        **changes,
    )


def coverage(
    plan: CoveragePlan,
    studies: int,
    *,
    mapper: Mapper | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """Simulate and judge studies, and average."""
    if studies < 2:
        raise UsageError(
            "a standard error needs at least two studies.", key="studies", value=studies
        )
    judge = functools.partial(judge_study, plan)
    kept = Checkpoint(checkpoint, plan.key, what="judged")
    return averaged(plan, kept.complete(judge, studies, mapper=mapper, progress=progress))


def averaged(plan: CoveragePlan, judged: list[dict[str, Any]]) -> pd.DataFrame:
    """Average what became of each claim over studies; one withheld or refused counts among all of them.

    `stated` is the level, or the confidence for kind share; `held` the mean fraction that was true.
    """
    claims = pd.DataFrame(
        [row for study in judged for row in study["judged"]], columns=[*LABELS, "held"]
    )
    rows = []
    for labels, group in claims.groupby(LABELS, sort=False):
        held, (claim, kind, *_) = group["held"].to_numpy(), labels
        stated = plan.confidence if kind == "share" else plan.level
        if claim in ("withheld", "refused"):
            held, stated = np.append(held, np.zeros(len(judged) - held.size)), math.nan
        counted = plan.subjects, plan.truth, stated, held.mean(), standard_error(held), held.size
        rows.append((*labels, *counted))
    return pd.DataFrame(rows, columns=[*LABELS, *_COUNTED])


def standard_error(held: NDArray[np.float64]) -> float:
    """Return the standard error of a mean; of studies that all agree, as of one half more and one half less.

    Six studies of six that hold do not make a coverage certain.
    """
    if held.size < 2:
        return float("nan")
    if np.ptp(held) > 0:
        return float(held.std(ddof=1) / np.sqrt(held.size))
    rate = (held.sum() + 0.5) / (held.size + 1.0)
    return float(np.sqrt(rate * (1.0 - rate) / (held.size + 1.0)))


def coverage_markdown(rows: pd.DataFrame) -> str:
    """Write coverage as a table in Markdown: each figure with its standard error, in per cent."""
    lines = [
        (
            "| claim | kind | method | family | joint | shape | users | n | stated | real | ± |"
            " studies |"
        ),
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows.to_dict("records"):
        cells = [
            *(row[name] for name in (*LABELS, "truth", "subjects")),
            "" if math.isnan(row["stated"]) else f"{100 * row['stated']:g} %",
            f"{100 * row['held']:.2f} %",
            "–" if math.isnan(row["error"]) else f"{100 * row['error']:.2f}",
            row["studies"],
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"


def advice_plans(study: Study) -> tuple[CoveragePlan, CoveragePlan]:
    """Plan studies of this design with users of the fitted model, and with normal users without pooling."""
    values = fitted_values(study)
    scene = study.scene
    model = scene.model.model_dump(exclude_none=True)
    fitted = plan_like(study, truth=scene.inference.family, model=model, values=values, each=True)
    return fitted, replace(fitted, truth="normal", values=own_values(study, values))


def gather(
    plans: tuple[CoveragePlan, ...],
    checkpoint: str | os.PathLike[str],
    *,
    studies: tuple[int, int] = STUDIES,
    mapper: Mapper | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """Simulate studies of each plan until enough are judged by either method; a row per interval."""
    tables = []
    for plan, users in zip(plans, _USERS, strict=False):
        for method, wanted in zip(_METHODS, studies, strict=True):
            asked = plan if method == "bayesian" else replace(plan, method="classical")
            tried, fewest = wanted, 0
            # Normal users below zero leave no lognormal fit: more studies make up for those.
            while fewest < wanted and tried <= max(studies):
                rows = coverage(
                    asked, tried, mapper=mapper, checkpoint=checkpoint, progress=progress
                )
                rows = rows[(rows["method"] == method) & (rows["kind"] == "user")]
                tried, fewest = 2 * tried, rows["studies"].min() if len(rows) else 0
            tables.append(rows.assign(plan=plan.key, users=users))
    return pd.concat(tables)


def recommend(
    study: Study, folder: str | os.PathLike[str], command: str, studies: tuple[int, int] = STUDIES
) -> list[str]:
    """Say which interval of the next user to use, or what theory says and the command that would tell."""
    try:
        keys = [plan.key for plan in advice_plans(study)]
    except RefusalError as error:
        return [f"{_THEORY} Studies like this one cannot be simulated: {error.message}"]
    path = Path(folder) / FILE
    if path.exists():
        table = pd.read_csv(path)
        needed = table["method"].map(dict(zip(_METHODS, studies, strict=True)))
        table = table[table["plan"].isin(keys) & (table["studies"] >= needed)]
        if said := list(_sentences(table, study.intervals, study.sessions.quantities)):
            return said
    return [f"{_THEORY} For this design {command} would tell."]


def _sentences(
    table: pd.DataFrame, intervals: pd.DataFrame, quantities: Quantities
) -> Iterator[str]:
    """Recommend one method for each interval that both methods were judged for under both truths."""
    user = intervals[(intervals["kind"] == "user") & (intervals["joint"] == "marginal")]
    for (environment, parameter), shown in user.groupby(["environment", "parameter"], sort=False):
        rows = table[table["claim"] == EACH.format(environment=environment, parameter=parameter)]
        if len(rows) < 2 * len(_METHODS):
            continue
        # The truth under which a method covers least decides.
        least = {m: rows[rows["method"] == m].sort_values("held").iloc[0] for m in _METHODS}
        width = (
            (shown["upper"] - shown["lower"]).groupby([shown["method"], shown["family"]]).first()
        )
        size = {m: float(width[m, row["family"]]) for m, row in least.items()}
        keeps = {
            m: row["held"] + _ERRORS * row["error"] >= row["stated"] for m, row in least.items()
        }
        use = max(_METHODS, key=lambda m: (keeps[m], -size[m] if keeps[m] else least[m]["held"]))
        (other,) = (m for m in _METHODS if m != use)
        covers = {
            m: f"{100 * row['held']:.2f} ± {100 * row['error']:.2f} % of {row['users']}"
            for m, row in least.items()
        }
        stated, ratio = 100 * least[use]["stated"], size[other] / size[use]
        yield (
            f"For {quantities[str(parameter)].label} in {environment} use the {_METHODS[use]}"
            f" interval of the next user: it covers {covers[use]} where {stated:g} % is stated. The"
            f" {_METHODS[other]} one covers {covers[other]} and is {ratio:.2f} times as wide."
        )
