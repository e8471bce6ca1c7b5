"""Analysis of variance against published tables, projections of dense designs, and t tests."""

import itertools

import numpy as np
import pytest
from scipy import stats

from percept import RefusalError
from percept.inference.classical.contrasts import anova

#: Accuracy of six people, two ways of calibration and four shapes of dials: ibid., table 7.7.
DIALS = [[0, 0, 5, 3], [3, 1, 5, 4], [4, 3, 6, 2], [4, 2, 7, 8], [5, 4, 6, 6], [7, 5, 8, 9]]


def as_printed(effects, name, digits):
    return [round(getattr(effect, name), digits) for effect in effects]


def test_a_factor_and_groups_of_a_textbook():
    group = np.repeat([0, 1], 3)
    effects = anova(np.array(DIALS, dtype=float), ["shape"], group=group, between="calibration")
    names = [effect.factors for effect in effects]
    assert names == [("calibration",), ("shape",), ("calibration", "shape")]
    assert as_printed(effects, "f", 2) == [11.89, 12.80, 2.01]
    assert as_printed(effects, "p_value", 4) == [0.0261, 0.0005, 0.1662]
    assert as_printed(effects, "epsilon", 4) == [1.0, 0.4751, 0.4751]
    assert as_printed(effects, "p_corrected", 4) == [0.0261, 0.0099, 0.2152]


def coded(levels):
    """Deviations from the last level, (levels, levels - 1): no contrasts that are orthogonal."""
    return np.vstack([np.eye(levels - 1), -np.ones(levels - 1)])


def projection(columns):
    # Columns without their fixed part have lost rank: rounding is no direction.
    return columns @ np.linalg.pinv(columns, rcond=1e-9)


def dense_squares(values, group):
    """Sums of squares (effect, error) of every effect by projections of all values together."""
    n = len(values)
    shape = values.shape[1:]
    y = values.ravel()
    subjects = np.eye(n)
    by_group = {False: np.ones((n, 1)), True: coded(group.max() + 1)[group]}
    fixed = {}
    errors = {}
    for inside in itertools.product([False, True], repeat=len(shape)):
        cells = np.ones((1, 1))
        for within, levels in zip(inside, shape, strict=True):
            cells = np.kron(cells, coded(levels) if within else np.ones((levels, 1)))
        errors[inside] = np.kron(subjects, cells)
        for between in (False, True) if group.any() else (False,):
            fixed[between, *inside] = np.kron(by_group[between], cells)
    every = projection(np.hstack(list(fixed.values())))
    found = {}
    for key in fixed:
        others = np.hstack([columns for other, columns in fixed.items() if other != key])
        effect = y @ (every - projection(others)) @ y
        columns = errors[key[1:]] - every @ errors[key[1:]]
        found[key] = effect, y @ projection(columns) @ y
    error_of_all = sum(found[key][1] for key in found if not key[0])
    return found, error_of_all


@pytest.mark.parametrize(
    ("shape", "sizes"),
    [
        ((7, 3), [7]),
        ((6, 2, 3), [6]),
        ((7, 3), [3, 4]),
        ((9, 2, 3), [4, 2, 3]),
        ((5, 2, 2, 3), [5]),
    ],
)
def test_sums_of_squares_are_those_of_projections(shape, sizes):
    rng = np.random.default_rng(len(shape))
    values = rng.normal(3.0, 1.0, shape) + rng.normal(0.0, 2.0, (shape[0], *[1] * (len(shape) - 1)))
    group = np.repeat(np.arange(len(sizes)), sizes)
    names = [f"factor {number}" for number in range(1, len(shape))]
    effects = anova(values, names, group=group, between="group")
    squares, error_of_all = dense_squares(values, group)
    assert len(effects) == len(squares) - 1
    for effect in effects:
        key = ("group" in effect.factors, *(name in effect.factors for name in names))
        among, error = squares[key]
        expected = (among / effect.df) / (error / effect.df_error)
        assert effect.f == pytest.approx(expected, rel=1e-9)
        assert effect.partial_eta2 == pytest.approx(among / (among + error), rel=1e-9)
        generalised = among / (among + error_of_all)
        assert effect.generalised_eta2 == pytest.approx(generalised, rel=1e-9)


@pytest.mark.parametrize(("subjects", "levels"), [(8, 5), (4, 7), (2, 3), (5, 60)])
def test_epsilon_is_that_of_the_covariance_of_the_conditions(subjects, levels):
    """Box's form: of the elements of the covariance matrix, its diagonal, rows and mean."""
    values = np.random.default_rng(4).normal(size=(subjects, levels))
    values *= np.linspace(1.0, 5.0, levels)
    covariance = np.cov(values.T)
    k = len(covariance)
    mean = covariance.mean()
    above = k**2 * (np.diag(covariance).mean() - mean) ** 2
    rows = covariance.mean(axis=1)
    below = (k - 1) * (np.sum(covariance**2) - 2 * k * np.sum(rows**2) + k**2 * mean**2)
    (effect,) = anova(values, ["level"])
    assert effect.epsilon == pytest.approx(above / below, rel=1e-12)
    df = effect.epsilon * (levels - 1)
    expected = stats.f.sf(effect.f, df, df * (subjects - 1))
    assert effect.p_corrected == pytest.approx(expected, rel=1e-10)


def test_an_offset_and_a_factor_change_nothing_and_the_input_stays():
    values = np.random.default_rng(5).normal(size=(6, 4))
    before = values.copy()
    (effect,) = anova(values, ["level"])
    (moved,) = anova(1e6 + 1e-3 * values, ["level"])
    np.testing.assert_array_equal(values, before)
    assert moved.f == pytest.approx(effect.f, rel=1e-5)
    assert moved.epsilon == pytest.approx(effect.epsilon, rel=1e-5)


def test_what_has_no_f_is_refused():
    alike = np.array([[1.0, 2.0], [2.0, 3.0], [4.0, 5.0]])
    with pytest.raises(RefusalError, match="the same effect of hand: with no scatter"):
        anova(alike, ["hand"])
    with pytest.raises(RefusalError, match="two subjects in every group"):
        anova(np.eye(3), ["hand"], group=np.array([0, 0, 1]))
    # Rounding of the values is no scatter: F would be 1e25.
    rounded = np.array([[1000.1, 1000.3], [1000.4, 1000.6]])
    with pytest.raises(RefusalError, match="the same effect of hand: with no scatter"):
        anova(rounded, ["hand"])
    with pytest.raises(RefusalError, match="an analysis of variance needs two levels of hand"):
        anova(np.array([[1.0], [2.0], [4.0]]), ["hand"])
