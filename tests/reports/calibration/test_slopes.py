"""Limits of a covariate's slope hold the truth where subjects' slopes differ.

Studies of eight subjects in two environments with eight trials a cell are simulated. Each subject's
responses follow the covariate by a slope of their own, of SD 0.06 about none.
"""

import numpy as np
import pytest
from scipy import stats

from percept.inference.model.limits import Combinations, Limits, limits_of
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from reports.studies import Observed, model_of

SUBJECTS = 8
CELLS = 2
TRIALS = 8
#: SDs of subjects' slopes for one SD of the covariate, and of trials, on the response scale.
SLOPE_SD = 0.06
TRIAL_SD = 0.1
#: Name of the slope among the limits.
_SLOPE = ("contrast", "slope")


def simulated(rng: np.random.Generator) -> Observed:
    """Simulate a study whose average slope is zero."""
    subject = np.repeat(np.arange(SUBJECTS), CELLS * TRIALS)
    cell = np.tile(np.repeat(np.arange(CELLS), TRIALS), SUBJECTS)
    covariate = rng.standard_normal(len(cell))
    effects = rng.normal(0.0, 0.15, SUBJECTS)[subject]
    departures = rng.normal(0.0, 0.1, (SUBJECTS, CELLS))[subject, cell]
    slopes = rng.normal(0.0, SLOPE_SD, SUBJECTS)[subject]
    noise = rng.normal(0.0, TRIAL_SD, len(cell))
    response = effects + departures + slopes * covariate + noise
    return Observed(
        parameters=("k",),
        response=response[:, None],
        subject=subject,
        cell=cell,
        environment=np.arange(CELLS),
        x=np.array([[-0.5, 0.5]]),
        covariate=covariate,
    )


def slope_limits(index: int) -> tuple[float, float]:
    """Return the 99 % limits of the average slope, which is zero, in study `index`."""
    model = model_of(simulated(np.random.default_rng([7, index])))
    row = np.zeros((1, model.locations))
    row[0, len(model.cells)] = 1.0
    limits = Limits(model, kinds=("mean",), further=[Combinations((_SLOPE,), row, ("mean",))])
    run = sample(model, limits, Settings(tolerance=0.03, seed=1 + index))
    lower, upper = limits_of(run.estimates.names, run.estimates.value, "mean", [_SLOPE])
    return float(lower[0]), float(upper[0])


#: Studies, and how many of them may miss: at 99 % more do with a probability below 0.1 %.
STUDIES = 40


@pytest.mark.evidence
def test_limits_hold_the_average_slope_as_often_as_they_say():
    limits = [slope_limits(index) for index in range(STUDIES)]
    missed = sum(not lower < 0.0 < upper for lower, upper in limits)
    assert missed <= stats.binom.ppf(0.999, STUDIES, 0.01)
    # The t-interval of eight known slopes of this SD has half-widths of 0.07.
    half_widths = [0.5 * (upper - lower) for lower, upper in limits]
    assert 0.05 < sum(half_widths) / STUDIES < 0.11
