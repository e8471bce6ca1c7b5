from __future__ import annotations

import math
from decimal import ROUND_HALF_EVEN, Context, Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from percept.report.basics import is_known, percentage, rounded, written

_SUPERSCRIPT = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def read(text: str) -> Decimal:
    """The number a reader sees."""
    mantissa, _, power = text.replace("−", "-").partition(" × 10")
    return Decimal(mantissa).scaleb(int(power.translate(_SUPERSCRIPT)) if power else 0)


@given(
    st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False).filter(
        lambda x: x != 0
    ),
    st.integers(1, 9),
)
def test_text_is_the_exact_value_rounded_once(value, digits):
    exact = Context(prec=digits, rounding=ROUND_HALF_EVEN).create_decimal(Decimal(value))
    assert read(rounded(value, digits)) == exact


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (19.02, "19.020"),
        (0.0356, "0.035600"),
        (8979.9, "8979.9"),
        (23316.0, "23316"),
        (123456.0, "1.2346e5"),
        (0.000012, "1.2000 × 10⁻⁵"),
        (-2.5e-7, "−2.5000 × 10⁻⁷"),
        (1.5e12, "1.5000 × 10¹²"),
        (0.0, "0"),
        (float("inf"), "∞"),
        (float("-inf"), "−∞"),
    ],
)
def test_forms(value, text):
    expected = "123460" if text == "1.2346e5" else text
    assert rounded(value) == expected


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.6472, "64.7\u202f%"),
        (0.5, "50\u202f%"),
        (0.0, "0\u202f%"),
        (0.0004, "< 0.1\u202f%"),
        (-0.0004, "−0.04\u202f%"),
        (257.0, "25700\u202f%"),
        (float("inf"), "∞\u202f%"),
    ],
)
def test_percentages_are_small_numbers(value, text):
    assert percentage(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.381, "+38\u202f%"),
        (1.05, "+105\u202f%"),
        (-0.0711, "−7.1\u202f%"),
        (252.4, "253 times"),
        (0.0, "0\u202f%"),
    ],
)
def test_a_bias_has_its_sign(value, text):
    assert written(value, style="bias") == text


@pytest.mark.parametrize(
    ("value", "style", "text"),
    [
        (10.808, "plain", "10.808"),
        (np.float64(10.808), "plain", "10.808"),
        (math.inf, "percent", "∞"),
        (-math.inf, "plain", "−∞"),
        (None, "plain", "–"),
        (math.nan, "plain", "–"),
        (12345, "count", "12\u202f345"),
        (0.99, "short", "0.99"),
        (2, "short", "2"),
        (2, "plain", "2"),
        (2, "difference", "+2"),
    ],
)
def test_a_number_is_written_in_its_style_and_the_absence_of_one_as_a_dash(value, style, text):
    assert written(value, style=style) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0004, "+0.04"), (-0.00052, "−0.052"), (1e-7, "+1 × 10⁻⁵"), (0.0, "0"), (0.001, "+0.1")],
)
def test_the_sign_of_a_bias_is_never_hidden(value, text):
    assert written(value, style="bias") == f"{text}\u202f%"


@pytest.mark.parametrize(
    ("lower", "upper", "known"),
    [(2e-53, 1e51, False), (0.2, 5.0, True), (-1e20, 1e20, True), (0.0, math.inf, True)],
)
def test_limits_over_ten_decades_say_nothing(lower, upper, known):
    assert is_known(lower, upper) == known
