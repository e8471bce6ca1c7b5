"""Which method to use for the next user: what simulated studies of one design cover, or else theory."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd

from percept.calibration.coverage import Coverage, coverage, fitted_values, own_values, plan_like
from percept.calibration.judge import EACH, CoveragePlan
from percept.errors import RefusalError
from percept.study import Study
from percept.study.basics import NAMES
from percept.workers import Mapper

#: Studies needed of the Bayesian and of the classical method, under either truth, before any is recommended.
STUDIES = 300, 10_000
FILE = "advice.csv"
#: Coverage under the stated level by more than so many standard errors counts as below it.
_ERRORS = 2.0
_METHODS = {"bayesian": "Bayesian", "classical": "classical"}
_THEORY = (
    "Which to use: for normal users the classical intervals cover exactly what they state. The Bayesian ones "
    "cover it on average over their priors."
)


def advice_plans(study: Study) -> tuple[CoveragePlan, CoveragePlan]:
    """Plan studies of this design with users of the fitted model, and with normal users without pooling."""
    values = fitted_values(study)
    scene = study.scene
    model = scene.model.model_dump(exclude_none=True)
    fitted = plan_like(study, truth=scene.inference.family, model=model, values=values, each=True)
    return fitted, dataclasses.replace(fitted, truth="normal", values=own_values(study, values))


def gather(
    plans: tuple[CoveragePlan, ...],
    checkpoint: str | os.PathLike[str],
    *,
    studies: tuple[int, int] = STUDIES,
    mapper: Mapper | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """Simulate studies of each plan until enough are judged by either method; a row per interval."""
    rows: list[dict[str, object]] = []
    for plan in plans:
        for method, wanted in zip(_METHODS, studies, strict=True):
            asked = plan if method == "bayesian" else dataclasses.replace(plan, method="classical")
            tried, found = wanted, list[Coverage]()
            # Normal users below zero leave no lognormal fit: more studies make up for those.
            while min((row.studies for row in found), default=0) < wanted and tried <= max(studies):
                every = coverage(asked, tried, mapper=mapper, checkpoint=checkpoint, progress=progress)
                found = [row for row in every if row.method == method and row.kind == "user"]
                tried *= 2
            rows += [{"plan": plan.key, **dataclasses.asdict(row)} for row in found]
    return pd.DataFrame(rows)


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
        if said := list(_sentences(table, study.intervals)):
            return said
    return [f"{_THEORY} For this design {command} would tell."]


def _sentences(table: pd.DataFrame, intervals: pd.DataFrame) -> Iterator[str]:
    """Recommend one method for each interval that both methods were judged for under both truths."""
    user = intervals[(intervals["kind"] == "user") & (intervals["joint"] == "marginal")]
    for (environment, parameter), shown in user.groupby(["environment", "parameter"], sort=False):
        rows = table[table["claim"] == EACH.format(environment=environment, parameter=parameter)]
        if len(rows) < 2 * len(_METHODS):
            continue
        # The truth under which a method covers least decides.
        least = {m: rows[rows["method"] == m].sort_values("held").iloc[0] for m in _METHODS}
        width = (shown["upper"] - shown["lower"]).groupby([shown["method"], shown["family"]]).first()
        size = {m: float(width[m, row["family"]]) for m, row in least.items()}
        keeps = {m: row["held"] + _ERRORS * row["error"] >= row["stated"] for m, row in least.items()}
        use = max(_METHODS, key=lambda m: (keeps[m], -size[m] if keeps[m] else least[m]["held"]))
        (other,) = (m for m in _METHODS if m != use)
        covers = {m: f"{100 * row['held']:.2f} ± {100 * row['error']:.2f} %" for m, row in least.items()}
        stated, ratio = 100 * least[use]["stated"], size[other] / size[use]
        yield (
            f"For {NAMES[str(parameter)]} in {environment} use the {_METHODS[use]} interval of the next "
            f"user: it covers {covers[use]} of users where {stated:g} % is stated. "
            f"The {_METHODS[other]} one covers {covers[other]} and is {ratio:.2g} times as wide."
        )
