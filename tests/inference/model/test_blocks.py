"""Block algebra against 2 x 2 matrices of 60 digits, at ratios where plain algebra loses
everything."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp

from percept.inference.model.blocks import Block, block
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


def test_block_holds_the_covariance_of_sds_and_correlation():
    for sd, rho, rest in [
        ((0.3, 2.0), 0.25, 0.75),
        ((1e-6, 1e6), -(1.0 - 1e-9), 1e-9),
        ((2.0, 2.0), 0.0, 1.0),
    ]:
        ours = block(tuple(np.array([s]) for s in sd), np.array([rho]), np.array([rest]))
        same(ours, exact.covariance(sd, np.sign(rho), rest) if rho else exact.covariance(sd, 0, 0))
    (variance,) = block((np.array([0.3]),)).variances
    np.testing.assert_allclose(variance, 0.09, rtol=1e-15)
    independent = block((np.array([0.3]), np.array([2.0])))
    same(independent, exact.matrix([[mp.mpf(0.3) ** 2, 0], [0, 4]]))


@settings(max_examples=60, deadline=None)
@given(covariances(), covariances())
def test_sum(first, second):
    with mp.workdps(exact.DIGITS):
        same(first[0] + second[0], first[1] + second[1])


@settings(max_examples=60, deadline=None)
@given(covariances(), exponents, exponents)
def test_plus_diagonal(one, d0, d1):
    ours, wanted = one
    added = (10.0**d0, 10.0**d1)
    with mp.workdps(exact.DIGITS):
        change = exact.matrix([[added[0], 0], [0, added[1]]])
        same(ours.plus_diagonal(tuple(np.array([a]) for a in added)), wanted + change)


@settings(max_examples=60, deadline=None)
@given(covariances(), st.floats(-3, 3), st.floats(-3, 3), st.floats(1e-3, 1e3))
def test_determinant_solution_entries_and_factor(one, r0, r1, factor):
    ours, wanted = one
    with mp.workdps(exact.DIGITS):
        determinant = mp.log(wanted[0, 0] * wanted[1, 1] - wanted[0, 1] ** 2)
        # Logs of both variances: the parts may cancel, so the bound is relative to them.
        size = 1 + sum(abs(mp.log(part[0])) for part in ours.variances)
        close(ours.log_determinant()[0], determinant, size)
        inverse = wanted**-1
        solved = ours.solve((np.array([r0]), np.array([r1])))
        solution = inverse * exact.matrix([[r0], [r1]])
        for i in range(2):
            size = abs(inverse[i, 0] * mp.mpf(r0)) + abs(inverse[i, 1] * mp.mpf(r1))
            close(solved[i][0], solution[i], size or 1)
        for matrix, found in ((wanted, ours.entries()), (inverse, ours.precision_entries())):
            for entry, (i, j) in zip(found, ((0, 0), (0, 1), (1, 1)), strict=True):
                close(entry[0], matrix[i, j], mp.sqrt(matrix[i, i] * matrix[j, j]))
        columns = ours.factor_columns()
        for i in range(2):
            for j in range(2):
                gram = mp.fsum(mp.mpf(float(c[i][0])) * mp.mpf(float(c[j][0])) for c in columns)
                close(gram, wanted[i, j], mp.sqrt(wanted[i, i] * wanted[j, j]))
        same(ours.scaled(np.array([factor])), wanted * mp.mpf(factor))


@settings(max_examples=60, deadline=None)
@given(covariances(), st.floats(-3, 3), st.floats(-3, 3))
def test_whitened_squares_are_the_distance(one, r0, r1):
    ours, wanted = one
    with mp.workdps(exact.DIGITS):
        vector = exact.matrix([[r0], [r1]])
        distance = (vector.T * wanted**-1 * vector)[0]
        white = ours.whiten((np.array([r0]), np.array([r1])))
        g = mp.mpf(float(ours.slope[0]))
        # r1 - g r0 is as exact as its terms are; nothing else may be lost.
        terms = (abs(vector[1]) + abs(g * vector[0])) / mp.sqrt(mp.mpf(float(ours.variances[1][0])))
        size = mp.sqrt(distance) + terms
        close(
            mp.sqrt(mp.fsum(mp.mpf(float(v[0])) ** 2 for v in white)), mp.sqrt(distance), size or 1
        )


def test_scalar_is_the_same_algebra_with_one_parameter():
    v, more, r = np.array([0.3, 7.0]), np.array([2.0, 1e-9]), np.array([1.5, -2.0])
    one = Block((v,))
    np.testing.assert_allclose((one + Block((more,))).variances[0], v + more)
    np.testing.assert_allclose(one.plus_diagonal((more,)).variances[0], v + more)
    np.testing.assert_allclose(one.precision_entries()[0] * v, 1.0, rtol=1e-15)
    np.testing.assert_allclose(one.solve((r,))[0], r / v)
    np.testing.assert_allclose(one.whiten((r,))[0] ** 2, r * r / v)
    np.testing.assert_allclose(one.factor_columns()[0][0] ** 2, v)
    np.testing.assert_allclose(one.log_determinant(), np.log(v))
    np.testing.assert_allclose(one.scaled(3.0).entries()[0], 3 * v)
    np.testing.assert_array_equal(one[0].variances[0], v[0])
