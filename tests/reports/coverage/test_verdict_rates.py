"""How often verdicts err: classical ones in simulated studies, Bayesian ones by the committed
page."""

import numpy as np
import pytest

from reports.coverage.rates import (
    CLEAR,
    DECISION,
    PLACES,
    SIZES,
    bayesian_study,
    binomial_error,
    errors_of,
    kept_fits,
    part_rates,
)
from tests import DATASETS, LONG

REPORT = DATASETS.parent / "reports" / "coverage" / "verdicts"
STUDIES = 20_000 if LONG else 1_000
MOST_WRONG = 1.0 - DECISION + CLEAR * binomial_error(STUDIES)


@pytest.fixture(scope="module")
def rates():
    return {(place, n): part_rates(n, place, STUDIES) for place in PLACES for n in SIZES}


@pytest.mark.evidence(reduced=True)
def test_classical_verdicts_on_stiffness_and_damping_keep_their_error_rates(rates):
    for (place, _), (real, does_not, _) in rates.items():
        if place != "well inside":
            assert real <= MOST_WRONG
        if place != "well outside":
            assert does_not <= MOST_WRONG


def test_bayesian_verdicts_keep_their_error_rates():
    found = {n: errors_of(list(kept_fits(n, REPORT).read().values())) for n in SIZES}
    for errors in found.values():
        assert errors.studies >= 50
        assert errors.within_promise()
    undecided = [errors.undecided for errors in found.values()]
    assert undecided == sorted(undecided, reverse=True)


def test_too_many_errors_break_the_promise():
    verdicts = [{"inside": number > 10, "outcome": "feels real"} for number in range(100)]
    # Eleven of 100 where five are allowed: 2.8 binomial errors too many, and of 300 4.8.
    assert errors_of([{"verdicts": verdicts}]).within_promise()
    assert not errors_of([{"verdicts": verdicts}] * 3).within_promise()


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("n", SIZES if LONG else SIZES[-1:])
def test_committed_studies_come_out_again(n):
    kept = kept_fits(n, REPORT).read()
    for index in list(kept)[: 10 if LONG else 1]:
        again = bayesian_study(n, index)["verdicts"]
        for verdict, before in zip(again, kept[index]["verdicts"], strict=True):
            assert verdict["inside"] == before["inside"]
            # Other versions of libraries draw another posterior sample.
            assert np.isclose(verdict["probability"], before["probability"], atol=0.1)
