"""Limits of a covariate's slope hold the truth where subjects' slopes differ."""

import pytest
from scipy import stats

from reports.calibration.slopes import slope_limits
from tests import LONG

#: Studies, and how many of them may miss: at 99 % more do with a probability below 0.1 %.
STUDIES = 40 if LONG else 5


@pytest.mark.evidence(reduced=True)
def test_limits_hold_the_average_slope_as_often_as_they_say():
    limits = [slope_limits(index) for index in range(STUDIES)]
    missed = sum(not lower < 0.0 < upper for lower, upper in limits)
    assert missed <= stats.binom.ppf(0.999, STUDIES, 0.01)
    # The t-interval of eight known slopes of this SD has half-widths of 0.07.
    half_widths = [0.5 * (upper - lower) for lower, upper in limits]
    assert 0.05 < sum(half_widths) / STUDIES < 0.11
