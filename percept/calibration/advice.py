"""Which method to use for the next user: how often each was right in simulated studies."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from percept.calibration.coverage import coverage, fitted_values, plan_like
from percept.calibration.judge import CoveragePlan, claim_of_cell
from percept.errors import RefusalError
from percept.sessions.quantities import Quantities
from percept.simulate.model import Hyperparameters, TrueValues
from percept.study import Study
from percept.workers import Mapper, in_process

#: Studies needed of each method, under either truth, before any is recommended. Classical ones cost
#: a thousandth of Bayesian ones.
STUDIES = {"bayesian": 300, "classical": 10_000}
#: File of the simulated coverage, in the folder of `percept calibrate --advice`.
ADVICE_FILE = "advice.csv"
# Standard errors, of the noisier method, by which coverage must miss the stated level to count as
# below it.
_ERRORS = 2.0
# The truths of the two plans, as sentences call them.
_USERS = ("users of the fitted model", "normal users")
_NAMES = {"bayesian": "Bayesian", "classical": "classical"}
# Least variance between subjects, as a share of what is observed: chance can leave less scatter
# between subjects than their trials explain.
_LEAST_VARIANCE = 0.01
_THEORY = (
    "Which to use: for normal users the classical intervals cover exactly what they state. The"
    " Bayesian ones cover it on average over their priors."
)


def own_values(study: Study, fitted: TrueValues) -> TrueValues:
    """Take the mean and SD of every cell as the truth of normal users, and the fitted trial noise.

    Parameters
    ----------
    study : Study
        The study.
    fitted : TrueValues
        As `fitted_values` gives them.

    Returns
    -------
    TrueValues
        Without effects that environments or subjects share.

    Raises
    ------
    RefusalError
        A cell has no mean and SD.
    """
    moments = study.data.moments("normal")
    mean = np.empty_like(fitted.beta)
    sd = np.empty_like(fitted.beta)
    for j, environment in enumerate(study.data.environments):
        for p, parameter in enumerate(study.data.parameters):
            reference = study.data.reference[parameter, environment]
            cell = moments.get((parameter, environment))
            if cell is None:
                label = study.sessions.quantities[parameter].label
                raise RefusalError(
                    f"{label} in {environment} has no mean and SD of its own to simulate from."
                )
            mean[j, p] = float(cell.mean) / reference
            sd[j, p] = float(cell.sd) / reference
    counts = study.sessions.table.groupby(["environment", "subject"], sort=False).size()
    # A subject's mean has the trial variance over its number of trials.
    trial_share = (1.0 / counts).groupby("environment", sort=False).mean().to_numpy()[:, None]
    omega_s = fitted.hyper.omega_s
    # Over subjects, whose log SDs are normal, the variance averages to this multiple.
    trial_variance = np.square(fitted.sigma_e) * np.exp(2.0 * np.square(omega_s))
    between = sd**2 - trial_share * trial_variance
    beta = mean - 1.0
    alone = Hyperparameters.zero(len(study.data.parameters))
    return TrueValues(
        hyper=replace(alone, omega_s=omega_s),
        delta=beta,
        beta=beta,
        sigma=np.sqrt(np.maximum(between, _LEAST_VARIANCE * sd**2)),
        sigma_e=fitted.sigma_e,
    )


def advice_plans(study: Study) -> tuple[CoveragePlan, CoveragePlan]:
    """Plan studies of this design with users of the fitted model, and with normal users.

    Parameters
    ----------
    study : Study
        The study.

    Returns
    -------
    tuple of CoveragePlan
        In this order.

    Raises
    ------
    RefusalError
        Studies like this one cannot be simulated.
    """
    values = fitted_values(study)
    scene = study.scene
    model = scene.model.model_dump(exclude_none=True)
    fitted = plan_like(
        study, users_family=scene.inference.family, model=model, values=values, each=True
    )
    return fitted, replace(fitted, users_family="normal", values=own_values(study, values))


def gather(
    plans: tuple[CoveragePlan, ...],
    checkpoint: str | os.PathLike[str],
    *,
    studies: dict[str, int] = STUDIES,
    mapper: Mapper = in_process,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """Simulate studies of each plan until enough are judged by either method.

    Parameters
    ----------
    plans : tuple of CoveragePlan
        As `advice_plans` gives them.
    checkpoint : str or path-like
        File that keeps judged studies.
    studies : dict of str to int
        How many are enough, by method.
    mapper : Mapper
        The workers.
    progress : callable, optional
        Told how many studies are finished, and of how many.

    Returns
    -------
    DataFrame
        A row per interval, method and plan.
    """
    tables = []
    for plan, users in zip(plans, _USERS, strict=False):
        for method, enough in studies.items():
            judged_plan = plan if method == "bayesian" else plan.by("classical")
            simulated = enough
            fewest = 0
            # Normal users below zero leave no lognormal fit: more studies make up for those.
            while fewest < enough and simulated <= max(studies.values()):
                rows = coverage(
                    judged_plan, simulated, mapper=mapper, checkpoint=checkpoint, progress=progress
                )
                of_user = (rows["method"] == method) & (rows["kind"] == "user")
                rows = rows[of_user]
                fewest = rows["studies"].min() if len(rows) else 0
                simulated *= 2
            tables.append(rows.assign(plan=plan.key, users=users))
    return pd.concat(tables)


def recommend(
    study: Study,
    folder: str | os.PathLike[str],
    command: str,
    studies: dict[str, int] = STUDIES,
) -> list[str]:
    """Say which interval of the next user to use, or the command that would tell.

    Parameters
    ----------
    study : Study
        The study.
    folder : str or path-like
        Where `gather`'s table was written.
    command : str
        The command that would write it.
    studies : dict of str to int
        How many are enough, by method.

    Returns
    -------
    list of str
        Sentences.
    """
    try:
        keys = [plan.key for plan in advice_plans(study)]
    except RefusalError as error:
        return [f"{_THEORY} Studies like this one cannot be simulated: {error.message}"]
    path = Path(folder) / ADVICE_FILE
    if path.exists():
        table = pd.read_csv(path)
        enough = table["studies"] >= table["method"].map(studies)
        of_plans = table[table["plan"].isin(keys) & enough]
        sentences = list(_sentences(of_plans, study.intervals, study.sessions.quantities))
        if sentences:
            return sentences
    return [f"{_THEORY} For this design {command} would tell."]


@dataclass(frozen=True)
class _Judgement:
    """How often one method's interval is right, under the truth where it is right least often."""

    method: str
    covered: float  # Share of the users
    error: float  # Its standard error
    stated: float
    users: str  # The truth
    width: float  # Of the interval that the study gives
    tolerance: float  # Of what is covered: one for both methods, so that noise forgives nobody more

    @property
    def keeps(self) -> bool:
        """Whether it covers what it states, but for chance."""
        return self.covered + self.tolerance >= self.stated

    @property
    def rank(self) -> tuple[bool, float]:
        """What recommends it: that it keeps what it states, then narrowness, or else coverage."""
        return self.keeps, -self.width if self.keeps else self.covered

    @property
    def words(self) -> str:
        """What it covers."""
        return f"{100 * self.covered:.2f} ± {100 * self.error:.2f} % of {self.users}"


def _sentences(
    table: pd.DataFrame, intervals: pd.DataFrame, quantities: Quantities
) -> Iterator[str]:
    """Recommend a method for each interval that was judged by both, under both truths."""
    user = intervals[(intervals["kind"] == "user") & (intervals["joint"] == "marginal")]
    for key, cell in user.groupby(["environment", "parameter"], sort=False):
        environment, parameter = map(str, key)
        rows = table[table["claim"] == claim_of_cell(parameter, environment)]
        if len(rows) < len(_NAMES) * len(_USERS):
            continue
        judgements = [_judgement(method, rows, cell) for method in _NAMES]
        best, other = sorted(judgements, key=lambda judgement: judgement.rank, reverse=True)
        label = quantities[parameter].label
        if not best.keeps:
            yield f"Neither method keeps its level for {label} in {environment}."
        yield (
            f"For {label} in {environment} use the {_NAMES[best.method]}"
            f" interval of the next user: it covers {best.words} where {100 * best.stated:g} % is"
            f" stated. The {_NAMES[other.method]} one covers {other.words} and is"
            f" {other.width / best.width:.2f} times as wide."
        )


def _judgement(method: str, rows: pd.DataFrame, intervals: pd.DataFrame) -> _Judgement:
    """Judge a method by the truth under which it covers least."""
    least = rows[rows["method"] == method].sort_values("held").iloc[0]
    same = (intervals["method"] == method) & (intervals["family"] == least["family"])
    interval = intervals.loc[same].iloc[0]
    return _Judgement(
        method=method,
        covered=float(least["held"]),
        error=float(least["error"]),
        stated=float(least["stated"]),
        users=str(least["users"]),
        width=float(interval["upper"] - interval["lower"]),
        tolerance=_ERRORS * float(rows["error"].max()),
    )
