"""Simulation-based calibration of studies with factors, .

Studies are drawn from the prior by `factor_studies` and fitted. Each true value has a place in its
posterior, a probability that is uniform over studies. Two wrong models must be caught.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.hierarchy.contrasts import ContrastEstimands, ContrastRows
from percept.inference.hierarchy.interval_estimands import IntervalEstimands
from percept.inference.hierarchy.linear_posterior import LinearPosterior
from percept.inference.sampling.gate import Run, Settings
from percept.inference.sampling.run import sample
from percept.provenance import Made, markdown_table
from reports.calibration.factor_studies import (
    GROUP,
    KINDS,
    Drawn,
    draw_study,
    model_of,
)
from reports.calibration.uniformity import Calibration, Plan, passed, ranks, verdict_table

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
PAGE = """# Simulation-based calibration of studies with factors

{fits} studies of each kind were drawn from the prior and fitted by the right model. Places of
true values in their posteriors are counted in {bins} bins. All quantities of a kind are judged
together, by simultaneous bands that a right model leaves with a probability of at most 1 %. Fits
that the gate withheld count as failed and have no places.

{made}

{right}

Scales, correlations and slopes of SDs are ranked among {draws} independent draws. Means of cells
and of contrasts, one more user of each, and slopes of covariates are placed by the posterior
distribution function.

## Wrong models

Each is fitted to studies that it does not hold for. A quantity outside the bands catches it.

{wrong}

## Every quantity

`tail` is the smallest two-sided probability of a count below the edge of a bin. Below `band` the
quantity lies outside.

{quantities}
"""


PLANS = (
    *(Plan(kind=kind) for kind in KINDS),
    *(Plan(kind=kind, wrong=wrong) for wrong, (kind, _) in WRONG.items()),
)


@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """Weights of what is placed beside the cells, with names."""

    weights: ContrastRows
    names: tuple[str, ...]  # Of contrasts that a user has too
    group_names: tuple[str, ...]  # Of the others and of slopes


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """A study of a plan, its model, and the run."""

    drawn: Drawn
    model: LinearPosterior
    rows: Rows
    run: Run
    seed: np.random.SeedSequence  # Of what is chosen from the draws


def fit_study(plan: Plan, index: int) -> Fitted:
    """Draw study `index` of a plan and fit it."""
    spawn_key = (list(KINDS).index(plan.kind), index)
    seeds = np.random.SeedSequence(plan.seed, spawn_key=spawn_key)
    truth_seed, run_seed, draw_seed = seeds.spawn(3)
    drawn = draw_study(KINDS[plan.kind], np.random.default_rng(truth_seed))
    options = WRONG[plan.wrong][1] if plan.wrong else {}
    model = model_of(drawn, **options)
    rows = contrast_rows(drawn, model)
    claims = IntervalEstimands(model, kinds=("mean", "user"))
    users = [*model.cells, *(("contrast", name) for name in rows.names)]
    groups = [("contrast", name) for name in rows.group_names]
    estimands = ContrastEstimands(model, rows.weights, tuple(users), tuple(groups), claims)
    settings = Settings(tolerance=plan.tolerance, seed=int(run_seed.generate_state(1)[0]))
    return Fitted(drawn, model, rows, sample(model, estimands, settings), draw_seed)


def place_study(plan: Plan, index: int) -> dict[str, float]:
    """Place the true values of study `index` of a plan; RefusalError without a fit."""
    fitted = fit_study(plan, index)
    points = np.concatenate(passed(fitted.run).independent())
    rng = np.random.default_rng(fitted.seed)
    chosen = points[rng.choice(len(points), size=plan.draws, replace=False)]
    found = scale_places(fitted.drawn, fitted.model, chosen)
    return found | places(fitted.drawn, fitted.model, fitted.rows, points)


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


def scale_places(drawn: Drawn, model: LinearPosterior, points: Array) -> dict[str, float]:
    """Return the place of every true scale among draws."""
    found = {}
    for name, (_, values) in model.scales(points).items():
        among = ranks(values, np.ravel(drawn.truth[name]))
        for number, place in enumerate(among.tolist()):
            found[f"{name}[{number + 1}]" if len(among) > 1 else name] = place
    return found


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


def page(calibrations: Sequence[Calibration], fits: int, made: Made) -> str:
    """Write the verdicts on right and wrong models, and every quantity of the right ones."""
    right = [calibration for calibration in calibrations if calibration.kind not in WRONG]
    wrong = [calibration for calibration in calibrations if calibration.kind in WRONG]
    quantities = []
    for calibration in right:
        band = f"{calibration.tail:.2g}"
        for judged in calibration.quantities:
            quantities.append([calibration.kind, judged.quantity, f"{judged.least_tail:.2g}", band])
    return PAGE.format(
        fits=fits,
        bins=PLANS[0].bins,
        draws=PLANS[0].draws,
        made=made.sentence,
        right=verdict_table("kind", right),
        wrong=verdict_table("kind", wrong),
        quantities=markdown_table(["kind", "quantity", "tail", "band"], quantities),
    )
