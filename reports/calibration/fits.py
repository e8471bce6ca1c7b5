"""Simulation-based calibration (Talts et al. 2018): the posterior must hold what the prior says.

Studies are drawn from the prior and fitted. Over them, a true value's rank among independent
posterior draws is uniform, and so is the posterior distribution function at it, if the density, the
sampler and the conditionals are right. `uniformity` judges whether they are. Two wrong models must
be caught.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.model.contrasts import ContrastEstimands, ContrastRows
from percept.inference.model.interval_estimands import IntervalEstimands
from percept.inference.model.linear_posterior import LinearPosterior
from percept.inference.sampling.gate import Run, Settings
from percept.inference.sampling.run import sample
from percept.provenance import Made
from reports.calibration.studies import (
    DESIGNS,
    GROUP,
    KINDS,
    Drawn,
    draw_plain,
    draw_study,
    model_of,
)
from reports.calibration.uniformity import (
    ERROR,
    Calibration,
    Plan,
    passed,
    ranks,
    verdict_table,
)

Array = NDArray[np.float64]

#: What a wrong model leaves out, by its name: the study it is fitted to, and the option that does.
WRONG: dict[str, tuple[str, dict[str, bool]]] = {
    "without subjects' contrasts": (
        "two factors with interaction",
        {"subjects_contrasts": False},
    ),
    "one trial SD for all subjects": ("subjects' own trial SDs", {"own_trial_sds": False}),
}
#: A right model needs so many times the fits that show a wrong one.
WRONG_SHARE = 6
PAGE = """# Simulation-based calibration

{total} studies were drawn from the prior and fitted. True scales, correlations and locations are\
 ranked among independent posterior draws; `mean` and `user` are the posterior distribution\
 functions at the true mean and at a new user. Each design's quantities are judged together by\
 simultaneous bands that a right density leaves with a probability of at most {error:g} %. Fits the\
 gate withheld are counted as failed and give no ranks. With few fits only large errors show.

{made}

{right}"""
WRONG_MODELS = """

## Wrong models

Each is fitted to studies that it does not hold for. A quantity outside the bands catches it.

{wrong}"""
#: What each page calibrates.
PLANS = {
    "sbc": tuple(Plan(kind=kind) for kind in DESIGNS),
    "factors": (
        *(Plan(kind=kind) for kind in KINDS),
        *(Plan(kind=kind, wrong=wrong) for wrong, (kind, _) in WRONG.items()),
    ),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """Weights of what is placed beside the cells, with names."""

    weights: ContrastRows
    names: tuple[str, ...]  # Of contrasts that a user has too
    group_names: tuple[str, ...]  # Of the others and of slopes

    def estimands(self, model: LinearPosterior, level: float = 0.99) -> ContrastEstimands:
        """Return limits of means and users, of the model's cells and of these rows."""
        claims = IntervalEstimands(model, kinds=("mean", "user"), level=level)
        users = (*model.cells, *(("contrast", name) for name in self.names))
        groups = tuple(("contrast", name) for name in self.group_names)
        return ContrastEstimands(model, self.weights, users, groups, claims)


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """A study of a plan, its model, and the run."""

    drawn: Drawn
    model: LinearPosterior
    rows: Rows
    run: Run
    seed: np.random.SeedSequence  # Of what is chosen from the draws


def fit_study(
    plan: Plan,
    index: int,
    change: Callable[[LinearPosterior], LinearPosterior] = lambda model: model,
) -> Fitted:
    """Draw study `index` of a plan and fit it; a changed model must be caught."""
    plain = plan.kind in DESIGNS
    kinds = list(DESIGNS if plain else KINDS)
    seeds = np.random.SeedSequence(plan.seed, spawn_key=(kinds.index(plan.kind), index))
    truth_seed, run_seed, draw_seed = seeds.spawn(3)
    rng = np.random.default_rng(truth_seed)
    drawn = draw_plain(plan.kind, rng) if plain else draw_study(KINDS[plan.kind], rng)
    options = WRONG[plan.wrong][1] if plan.wrong else {}
    model = change(model_of(drawn, **options))
    rows = contrast_rows(drawn, model)
    settings = Settings(tolerance=plan.tolerance, seed=int(run_seed.generate_state(1)[0]))
    return Fitted(drawn, model, rows, sample(model, rows.estimands(model), settings), draw_seed)


def place_study(
    plan: Plan,
    index: int,
    change: Callable[[LinearPosterior], LinearPosterior] = lambda model: model,
) -> dict[str, float]:
    """Place the true values of study `index` of a plan; RefusalError without a fit."""
    fitted = fit_study(plan, index, change)
    model = fitted.model
    points = np.concatenate(passed(fitted.run).independent())
    rng = np.random.default_rng(fitted.seed)
    chosen = points[rng.choice(len(points), size=plan.draws, replace=False)]
    found = {}
    for name, (dimensions, values) in model.scales(chosen).items():
        labels = _labels(model, dimensions, values.shape[1:])
        among = ranks(values, np.ravel(fitted.drawn.truth[name]))
        for label, place in zip(labels, among.tolist(), strict=True):
            found[name + label] = place
    locations, _ = model.draw(chosen, rng)
    among = ranks(locations, fitted.drawn.beta.ravel())
    for cell, place in zip(model.cells, among.tolist(), strict=True):
        found[f"beta[{','.join(cell)}]"] = place
    return found | places(fitted.drawn, model, fitted.rows, points)


def _labels(model: LinearPosterior, dimensions: Sequence[str], shape: tuple[int, ...]) -> list[str]:
    """Return what tells the values of one name apart."""
    statistics = model.statistics
    names: dict[str, Sequence[object]] = {
        "parameter": statistics.parameters,
        "environment": statistics.environments,
        "subject": statistics.subjects,
    }
    if not shape:
        return [""]
    axes = []
    for dimension, size in zip(dimensions, shape, strict=True):
        axes.append(names.get(dimension, range(1, size + 1)))
    return [f"[{','.join(map(str, each))}]" for each in itertools.product(*axes)]


def contrast_rows(drawn: Drawn, model: LinearPosterior) -> Rows:
    """Every term's contrast over all cells, and the slopes of a covariate, quantity by quantity."""
    size, cells = drawn.beta.shape
    within: dict[str, Array] = {}
    groups: dict[str, Array] = {}
    for p, parameter in enumerate(drawn.kind.parameters):
        for term, contrast in drawn.contrast.items():
            row = np.zeros(model.locations_count)
            row[p * cells : (p + 1) * cells] = contrast
            kept = groups if GROUP in term.split(":") else within
            kept[f"{parameter},{term}"] = row
        if drawn.kind.covariate:
            row = np.zeros(model.locations_count)
            row[size * cells + p] = 1.0
            groups[f"{parameter},slope"] = row
    every = np.eye(size * cells, model.locations_count)

    def stacked(kept: Mapping[str, Array]) -> Array:
        return np.reshape(list(kept.values()), (-1, model.locations_count))

    weights = ContrastRows(every, stacked(within), stacked(groups))
    return Rows(weights, tuple(within), tuple(groups))


def places(drawn: Drawn, model: LinearPosterior, rows: Rows, points: Array) -> dict[str, float]:
    """Posterior distribution functions at true means and at one more user."""
    weights = rows.weights
    every = np.vstack([weights.cells, weights.users, weights.groups])
    cell_names = [",".join(cell) for cell in model.cells]
    names = [*cell_names, *rows.names, *rows.group_names]
    laws = model.laws_of(every, points)
    of_users = len(cell_names) + len(rows.names)
    slopes = drawn.slope if drawn.kind.covariate else np.empty(0)
    means = every @ np.concatenate([drawn.beta.ravel(), slopes])
    users = every @ np.concatenate([drawn.user.ravel(), slopes])
    below_mean = special.ndtr((means - laws.mean) / laws.sd).mean(axis=0)
    user_sd = np.hypot(laws.sd, laws.population_sd)
    below_user = special.ndtr((users - laws.mean) / user_sd).mean(axis=0)
    found = {}
    for number, name in enumerate(names):
        found[f"mean[{name}]"] = float(below_mean[number])
        if number < of_users:
            found[f"user[{name}]"] = float(below_user[number])
    return found


def verdicts_json(calibrations: Sequence[Calibration]) -> str:
    """Write everything about the verdicts as JSON."""
    rows = []
    for calibration in calibrations:
        fields = dataclasses.asdict(calibration)
        rows.append({"design": fields.pop("kind"), **fields, "outside": calibration.outside})
    return json.dumps(rows, indent=1) + "\n"


def page(calibrations: Sequence[Calibration], made: Made) -> str:
    """Write the verdicts on right and wrong models with how to read them."""
    right = [calibration for calibration in calibrations if calibration.kind not in WRONG]
    wrong = [calibration for calibration in calibrations if calibration.kind in WRONG]
    text = PAGE.format(
        total=sum(calibration.fits for calibration in right),
        error=100 * ERROR,
        made=made.sentence,
        right=verdict_table(right),
    )
    return text + (WRONG_MODELS.format(wrong=verdict_table(wrong)) if wrong else "")
