"""Smaller hierarchical models against the full one, by how well they predict a subject left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

from percept.errors import RefusalError, UsageError
from percept.html import NotebookRecord
from percept.inference.hierarchy.scales import Options
from percept.inference.sampling.gate import Progress
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.basics import Skipped
from percept.study.checks import SubjectChecks, check_subjects
from percept.study.fit import RunStore, fit_model, prepare

#: Models compared, by what they leave out of the full one. "Weber trend" keeps each environment's own spread
#: about the trend, which takes up what the trend lacks: it seldom differs from "full". Weber's law itself is
#: put to the test by "exact Weber" against "common spread".
MODELS = {
    "full": Options(),
    "Weber trend": Options(weber=True),
    "common spread": Options(common_spread=True),
    "exact Weber": Options(weber=True, common_spread=True),
    "no subject effect": Options(subject_effect=False),
}
#: Differences below this many nats are too small for their standard error to be believed
#: (Sivula, Magnusson & Vehtari 2020, arXiv:2008.10296).
_SMALL = 4.0


@dataclasses.dataclass(frozen=True, eq=False)
class ModelChoice(NotebookRecord):
    """Models in the order of their predictive density."""

    table: pd.DataFrame  # A row per model, with its difference to the best
    failed: tuple[str, ...]  # Models that failed the gate, with the reason
    sentence: str  # What can be told


def compare_models(
    sessions: Sessions,
    scene: Scene,
    parameters: tuple[str, ...],
    *,
    models: tuple[str, ...] = tuple(MODELS),
    progress: Callable[[Progress], None] | None = None,
    store: RunStore | None = None,
) -> ModelChoice:
    """Fit models of `MODELS` and compare them by leave-one-subject-out predictive density."""
    if len(sessions.environments) == 1:
        raise RefusalError(
            "with one environment there is one model only.",
            hint="Models differ in how they join several environments.",
        )
    if unknown := [name for name in models if name not in MODELS]:
        raise UsageError(f"no such model; there are {', '.join(MODELS)}.", key="models", value=unknown[0])
    if sessions.form == "summary" or scene.model.pooling == "none":
        raise RefusalError(
            "models are compared on the sessions of subjects, pooled over environments.",
            hint='Give sessions instead of published limits, and pooling = "partial".',
        )
    found: dict[str, SubjectChecks] = {}
    failed = []
    for name in models:
        model = scene.model.model_dump(exclude_none=True) | dataclasses.asdict(MODELS[name])
        asked = scene.with_tables(model=model)
        fit = fit_model(prepare(sessions, asked, parameters), asked.inference, progress=progress, store=store)
        if fit.passed:
            assert not isinstance(fit.subjects, Skipped)
            found[name] = check_subjects(fit, fit.subjects, asked, progress=progress)
        else:
            failed.append(f"{name}: {fit.withheld}")
    if not found:
        raise RefusalError("no model passes the gate of the sampler.", hint=" ".join(failed))
    table = ranked(found)
    return ModelChoice(table, tuple(failed), sentence_of(table))


def ranked(found: Mapping[str, SubjectChecks]) -> pd.DataFrame:
    """Put models in the order of their density, with how far each lies behind the first."""
    order = sorted(found, key=lambda name: -found[name].elpd)
    best = found[order[0]].subjects["elpd"].to_numpy()
    rows = []
    for name in order:
        subjects = found[name].subjects
        behind = subjects["elpd"].to_numpy() - best
        rows.append(
            {
                "model": name,
                "elpd": found[name].elpd,
                "se": found[name].se,
                "difference": float(behind.sum()),
                "difference_se": float(np.sqrt(behind.size * behind.var(ddof=1))),
                "rough": int((subjects["influential"] & ~subjects["refitted"]).sum()),
            }
        )
    return pd.DataFrame(rows)


def sentence_of(table: pd.DataFrame) -> str:
    """Say which model is best, and which of the others are clearly worse."""
    behind = table.iloc[1:]
    clear = (behind["difference"] < -_SMALL) & (behind["difference"] < -2.0 * behind["difference_se"])
    told = f'"{table["model"].iloc[0]}" predicts a subject left out best'
    if not clear.all():
        told += f", not distinguishable from {', '.join(behind.loc[~clear, 'model'])}"
    if clear.any():
        told += f"; {', '.join(behind.loc[clear, 'model'])} clearly worse"
    if rough := int(table["rough"].sum()):
        told += (
            f". {rough} of the left-out densities are rough (Pareto index too high): use --refit to be sure"
        )
    return told + "."
