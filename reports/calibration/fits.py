"""Simulation-based calibration (Talts et al. 2018): the posterior must hold what the prior says.

Studies are drawn from the prior and fitted. Over them, a true value's rank among independent
posterior draws is uniform, and so is the posterior distribution function at it, if the density, the
sampler and the conditionals are right. `uniformity` judges whether they are. Two wrong models must
be caught.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from percept.errors import RefusalError
from percept.inference.model.limits import Limits
from percept.inference.model.model import LinearModel
from percept.inference.sampling.gate import Run, Settings
from percept.inference.sampling.run import sample
from percept.workers import processes
from reports.calibration.studies import KINDS, Drawn, draw_study
from reports.calibration.uniformity import ERROR, Calibration, Plan, calibrate
from reports.page import Page, say
from reports.studies import Array, Observed, model_of

#: What a wrong model leaves out, by its name: the study it is fitted to, and what it takes it for.
WRONG: dict[str, tuple[str, dict[str, Any]]] = {
    "without subjects' contrasts": (
        "two factors with interaction",
        {"groups": ("hand", "load")},
    ),
    "one trial SD for all subjects": ("subjects' own trial SDs", {"own_trial_sds": False}),
}
#: A right model needs so many times the fits that show a wrong one.
_WRONG_SHARE = 6
_INTRODUCTION = """\
Studies are drawn from the prior and fitted. True scales and correlations are ranked among
independent posterior draws; `mean` and `user` are the posterior distribution functions at the true
mean and at a new user, of cells and contrasts. Each design's quantities are judged together by
simultaneous bands that a right density leaves with a probability of at most {error:g} %. Fits the
gate withheld are counted as failed and give no ranks. With few fits only large errors show."""


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """A study of a plan, its model, and the run."""

    drawn: Drawn
    model: LinearModel
    run: Run
    rng: np.random.Generator  # Chooses among the draws


def fit_study(
    plan: Plan,
    index: int,
    change: Callable[[LinearModel], LinearModel] = lambda model: model,
) -> Fitted:
    """Draw study `index` of a plan and fit it; a changed model must be caught."""
    seeds = np.random.SeedSequence(plan.seed, spawn_key=(list(KINDS).index(plan.kind), index))
    truth_seed, run_seed, draw_seed = seeds.spawn(3)
    drawn = draw_study(KINDS[plan.kind], np.random.default_rng(truth_seed))
    taken_for = WRONG[plan.wrong][1] if plan.wrong else {}
    model = change(model_of(dataclasses.replace(drawn.observed, **taken_for)))
    settings = Settings(tolerance=plan.tolerance, seed=int(run_seed.generate_state(1)[0]))
    run = sample(model, Limits(model, kinds=("mean", "user")), settings)
    return Fitted(drawn, model, run, np.random.default_rng(draw_seed))


def place_study(
    plan: Plan,
    index: int,
    change: Callable[[LinearModel], LinearModel] = lambda model: model,
) -> dict[str, float]:
    """Place the true values of study `index` of a plan; RefusalError without a fit."""
    fitted = fit_study(plan, index, change)
    if not fitted.run.gate.passed:
        raise RefusalError(" ".join(fitted.run.gate.reasons))
    points = fitted.run.independent()
    chosen = points[fitted.rng.choice(len(points), size=plan.draws, replace=False)]
    found = {}
    for name, (_, values) in fitted.model.scales(chosen).items():
        below = values < fitted.drawn.truth[name]
        places = (below.sum(axis=0) + 0.5) / (len(values) + 1)
        for position, place in np.ndenumerate(places):
            found[name + _label(position)] = float(place)
    return found | places_of_locations(fitted, points)


def _label(position: tuple[int, ...]) -> str:
    """Return what tells the values of one name apart."""
    return f"[{','.join(str(number + 1) for number in position)}]" if position else ""


def places_of_locations(fitted: Fitted, points: Array) -> dict[str, float]:
    """Posterior distribution functions at true means and at one more user."""
    drawn = fitted.drawn
    study = drawn.observed
    rows = location_rows(study)
    slopes = drawn.slope if study.covariate is not None else np.empty(0)
    weights = np.array(list(rows.values()))
    # Coefficients of fixed terms, which stand last, have no weights.
    others = fitted.model.locations - weights.shape[1]
    laws = fitted.model.moments(points, np.pad(weights, ((0, 0), (0, others))))
    means = weights @ np.concatenate([drawn.beta.ravel(), slopes])
    users = weights @ np.concatenate([drawn.user.ravel(), slopes])
    below_mean = special.ndtr((means - laws.mean) / laws.sd).mean(axis=0)
    user_sd = np.hypot(laws.sd, laws.population_sd)
    below_user = special.ndtr((users - laws.mean) / user_sd).mean(axis=0)
    found = {}
    for number, name in enumerate(rows):
        found[f"mean[{name}]"] = float(below_mean[number])
        if "slope" not in name and not any(group in name for group in study.groups):
            found[f"user[{name}]"] = float(below_user[number])
    return found


def location_rows(study: Observed) -> dict[str, Array]:
    """Weights of cells, of every term's contrast over all cells, and of slopes, by name."""
    size, cells = study.x.shape
    slopes = size * (study.covariate is not None)
    units = np.eye(size * cells + slopes)
    rows = {}
    for (p, parameter), c in itertools.product(enumerate(study.parameters), range(cells)):
        rows[f"{parameter},{c + 1}"] = units[p * cells + c]
    for p, parameter in enumerate(study.parameters):
        for term, contrast in study.contrast.items():
            rows[f"{parameter},{term}"] = contrast @ units[p * cells : (p + 1) * cells]
        if slopes:
            rows[f"{parameter},slope"] = units[size * cells + p]
    return rows


def page(
    out: Path, *, fits: int = 300, kinds: tuple[str, ...] = tuple(KINDS), workers: int = 1
) -> Page:
    """Calibrate fits of studies of many kinds.

    Parameters
    ----------
    out : Path
        Folder of the page, which keeps placed studies.
    fits : int
        Studies of each kind.
    kinds : tuple of str
        Which kinds.
    workers : int
        Processes.

    Returns
    -------
    Page
        Two wrong models are on it, where their kinds of study are.
    """
    right = [_calibrated(Plan(kind=kind), fits, out, workers) for kind in kinds]
    wrong = []
    for name, (kind, _) in WRONG.items():
        if kind in kinds:
            plan = Plan(kind=kind, wrong=name)
            wrong.append(_calibrated(plan, fits // _WRONG_SHARE, out, workers))
    return written(right, wrong)


def _calibrated(plan: Plan, fits: int, out: Path, workers: int) -> Calibration:
    def progress(done: int, of: int) -> None:
        say(f"{plan.name}: {done} of {of}")

    return calibrate(
        plan, place_study, fits, folder=out, mapper=processes(workers), progress=progress
    )


def written(right: Sequence[Calibration], wrong: Sequence[Calibration] = ()) -> Page:
    """Write the verdicts on right and wrong models."""
    page = Page(
        "Simulation-based calibration",
        _INTRODUCTION.format(error=100 * ERROR),
        right=not any(one.outside for one in right) and all(one.outside for one in wrong),
    )
    heads = ["design", "fits", "failed", "quantities", "outside", "farthest", "tail", "band"]
    page.table(heads, [one.row for one in right])
    if wrong:
        page.add("## Wrong models")
        page.add(
            "Each is fitted to studies that it does not hold for. A quantity outside the bands"
            " catches it."
        )
        page.table(heads, [one.row for one in wrong])
    return page
