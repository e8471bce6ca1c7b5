import json

import mpmath as mp
import numpy as np
import pytest

from percept.errors import RefusalError, UsageError
from percept.inference import tolerance_factor
from percept.inference.classical.intervals import factor_of_tails
from tests import LONG

from . import oracles

REFERENCE = json.loads(oracles.TABLE.read_text(encoding="utf-8"))


def test_factors_against_quadrature_in_20_digits():
    n, share, confidence, exact = zip(*REFERENCE, strict=True)
    factors = tolerance_factor(n, share, confidence)
    truth = np.array([float(text) for text in exact])
    assert np.abs(factors / truth - 1.0).max() <= 1e-13


REMADE = REFERENCE[::10] if LONG else [REFERENCE[i] for i in (8, 87, 150, 240)]


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("row", REMADE, ids=str)
def test_the_reference_table_can_be_made_again(row):
    n, share, confidence, text = row
    exact, error = oracles.factor(n, share, confidence)
    assert abs(exact / mp.mpf(text) - 1) <= 1e-15
    assert abs(error) <= 1e-13


@pytest.mark.parametrize(
    ("n", "share", "confidence", "printed"),
    [
        (10, 0.99, 0.95, "4.436909"),
        (10, 0.99, 0.99, "5.610168"),
        (2, 0.9, 0.9, "15.512326"),
        (10, 0.95, 0.95, "3.3935"),
        (9, 0.99, 0.95, "4.6329"),
        (15, 0.99, 0.99, "4.6212"),
        (35, 0.9, 0.9, "1.9906"),
        (43, 0.9, 0.99, "2.222825"),
    ],
)
def test_published_factors(n, share, confidence, printed):
    factor = tolerance_factor(n, share, confidence)
    digits = len(printed.split(".")[1])
    # ISO 16269-6 rounds up in its last digit
    assert 0.0 <= float(printed) - factor <= 10.0**-digits or f"{factor:.{digits}f}" == printed


@pytest.mark.parametrize("tail", [1e-6, 1e-12])
def test_tails_that_a_double_cannot_say_from_one(tail):
    factor = factor_of_tails(9, 0.1, tail)
    with mp.workdps(oracles.DIGITS):
        miss = 1 - oracles.confidence_of(9, 1 - mp.mpf(0.1), mp.mpf(float(factor)))
        assert float(miss) == pytest.approx(tail, rel=1e-6)
    assert tolerance_factor(9, 0.9, 1.0 - tail) == pytest.approx(factor, rel=1e-4)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: tolerance_factor(10, 1.0, 0.95), UsageError, "value 1.0: share must lie strictly"),
        (lambda: tolerance_factor(10, 0.99, 95), UsageError, "confidence must lie .* 0.99"),
        (lambda: tolerance_factor(10, "a", 0.95), UsageError, "share must be a number"),
        (lambda: tolerance_factor(1, 0.99, 0.95), RefusalError, "At least 2 subjects"),
        (
            lambda: tolerance_factor([2, 3], [0.9, 0.9, 0.9], 0.95),
            UsageError,
            r"do not fit: \(2,\), \(3,\), \(\)",
        ),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()
