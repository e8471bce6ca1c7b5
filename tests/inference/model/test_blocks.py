"""Sums of blocks against 2 x 2 matrices of 60 digits, at ratios where plain algebra loses all."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp

from percept.inference.model.blocks import block
from tests.inference.model import exact

TOLERANCE = 2e-14
exponents = st.floats(-12.0, 12.0)


@st.composite
def covariances(draw):
    """Block of one entry, and the exact matrix of the same doubles."""
    sd = [10.0 ** (draw(exponents) / 2) for _ in range(2)]
    rest = 10.0 ** draw(st.floats(-9.0, 0.0))
    sign = draw(st.sampled_from([-1.0, 1.0]))
    rho = sign * (1.0 - rest)
    ours = block((np.array([sd[0]]), np.array([sd[1]])), np.array([rho]), np.array([rest]))
    return ours, exact.pair(ours.variances[0][0], ours.slope[0], ours.variances[1][0])


def close(value, wanted, scale=None):
    scale = abs(wanted) if scale is None else scale
    # The smallest subnormal is the spacing of doubles near zero, whatever the scale.
    assert abs(mp.mpf(float(value)) - wanted) <= TOLERANCE * scale + mp.mpf(2) ** -1074


def same(ours, wanted):
    """Every number a block holds, against the regression form of a 2 x 2 matrix."""
    v, g = wanted[0, 0], wanted[1, 0] / wanted[0, 0]
    w = wanted[1, 1] - wanted[1, 0] ** 2 / wanted[0, 0]
    close(ours.variances[0][0], v)
    close(ours.variances[1][0], w)
    close(ours.slope[0], g, max(abs(g), mp.sqrt(w / v)))


@pytest.fixture(autouse=True)
def digits():
    with mp.workdps(exact.DIGITS):
        yield


@settings(max_examples=60, deadline=None)
@given(covariances(), covariances())
def test_sum(first, second):
    with mp.workdps(exact.DIGITS):
        same(first[0] + second[0], first[1] + second[1])
