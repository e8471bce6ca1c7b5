import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from percept.errors import RefusalError, UsageError
from percept.inference import Moments, MomentsAccumulator
from percept.inference.classical.moments import mean_and_sd

MODERATE = st.floats(-1e150, 1e150, allow_nan=False)


def exact(values):
    """Return mean and variance as fractions."""
    fractions = [Fraction(value) for value in np.asarray(values).tolist()]
    mean = sum(fractions, Fraction(0)) / len(fractions)
    return mean, sum((value - mean) ** 2 for value in fractions) / (len(fractions) - 1)


def is_rounded_root(root, square):
    """Say whether `root` is the double nearest to the root of a fraction: compare with the midpoints."""
    below = (Fraction(math.nextafter(root, -math.inf)) + Fraction(root)) / 2
    above = (Fraction(math.nextafter(root, math.inf)) + Fraction(root)) / 2
    return max(below, Fraction(0)) ** 2 <= square <= above**2


def accumulated(*chunks):
    sums = MomentsAccumulator()
    for chunk in chunks:
        sums.update(chunk)
    return sums


@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False, max_value=1e307, min_value=-1e307), min_size=2)
)
def test_any_doubles_are_rounded_once(values):
    sums = accumulated(values)
    mean, variance = exact(values)
    assert sums.mean == float(mean)
    assert is_rounded_root(sums.sd, variance)


@pytest.mark.parametrize(
    "values",
    [
        [0.8635482396758255, 0.6963927613059283],
        [0.7937030766630794, 0.7833770279153258],
        [0.11511197158740283, 0.6752857519434767],
    ],
)
def test_roots_that_all_but_meet_the_middle_of_two_doubles_are_rounded_right(values):
    assert is_rounded_root(accumulated(values).sd, exact(values)[1])


@pytest.mark.parametrize("size", [300, 5_000])
def test_bins_agree_with_fractions(size):
    random = np.random.default_rng(size)
    for values in (
        1e15 + random.normal(size=size),
        random.normal(size=size) * 10.0 ** random.integers(-300, 140, size),
        5e-324 * random.integers(0, 50, size),
        np.full(size, 1.0 - 2.0**-53),
        np.full(size, -0.1),
    ):
        sums = accumulated(values)
        mean, variance = exact(values)
        assert sums.mean == float(mean)
        assert is_rounded_root(sums.sd, variance)


def test_bins_hold_the_largest_products_they_may_meet():
    # equal mantissas of all ones fill every bin to its limit in each chunk
    value = 2.0 - 2.0**-52
    values = np.full(3_000_000, value)
    values[0] = 0.0
    n = values.size
    sums = accumulated(values)
    mean = Fraction(value) * (n - 1) / n
    assert sums.mean == float(mean)
    assert is_rounded_root(sums.sd, Fraction(value) ** 2 / n)


def test_cuts_and_order_do_not_matter():
    values = np.random.default_rng(5).normal(size=5000) * 1e8 + 1e15
    whole = accumulated(values)
    parts = [accumulated(part) for part in np.array_split(values[::-1], 37)]
    merged = MomentsAccumulator()
    for part in parts:
        merged.merge(part)
    assert (merged.n, merged.mean, merged.sd) == (whole.n, whole.mean, whole.sd)


def test_an_empty_chunk_adds_nothing():
    assert accumulated([1.0, 2.0], [], [3.0]).mean == 2.0


def test_no_values_have_no_mean():
    with pytest.raises(UsageError, match="no values to average"):
        _ = MomentsAccumulator().mean


def test_one_value_has_no_sd():
    with pytest.raises(RefusalError, match="at least 2 values; there is 1"):
        _ = accumulated([3.0]).sd


def test_sd_beyond_the_largest_double():
    with pytest.raises(UsageError, match="larger than the largest double"):
        _ = accumulated([1.7e308, -1.7e308]).sd


def ulps(value, reference):
    return abs(value - reference) / math.ulp(reference)


@settings(max_examples=50, deadline=None)
@given(arrays(float, st.tuples(st.integers(9, 12), st.integers(2, 7)), elements=MODERATE))
def test_many_short_samples_are_within_four_ulp(samples):
    mean, sd = mean_and_sd(samples)
    for row, m, s in zip(samples, mean, sd, strict=True):
        sums = accumulated(row)
        assert ulps(m, sums.mean) <= 4
        assert ulps(s, sums.sd) <= 4


@pytest.mark.parametrize("n", [2, 3, 10, 33, 1000])
def test_the_pairs_of_doubles_against_exact_sums(n):
    random = np.random.default_rng(n)
    base = random.normal(size=(40, n))
    for samples in (
        base,
        base + 1e15,
        base * 1e-12 + 1.0,
        base * 10.0 ** random.integers(-140, 140, (40, n)),
        base * 1e-310,
        base * 1e307,
        np.full((40, n), 0.1),
    ):
        mean, sd = mean_and_sd(samples)
        truth = [accumulated(row) for row in samples]
        assert max(ulps(m, t.mean) for m, t in zip(mean, truth, strict=True)) <= 4
        assert max(ulps(s, t.sd) for s, t in zip(sd, truth, strict=True)) <= 4


def test_means_that_cancel_are_exact_among_many():
    samples = np.tile([1e16, 1.0, -1e16], (20, 1))
    assert Moments.from_values(samples).mean == pytest.approx(1 / 3, rel=1e-15)


def test_means_of_tiny_values_that_cancel_nearly_are_exact_among_many():
    samples = np.random.default_rng(3).random((40, 3))
    samples[:, 1] = -samples[:, 0]
    samples[:, 2] *= 1e-25
    truth = [math.fsum(row) / 3 for row in samples]
    np.testing.assert_allclose(Moments.from_values(samples).mean, truth, rtol=1e-15)  # two roundings


def test_values_near_the_largest_double_are_averaged_among_many():
    samples = np.tile([1.5e308, -1.5e308, 1.0e308, 0.5e308], (9, 1))
    found, truth = Moments.from_values(samples), accumulated(samples[0])
    assert max(ulps(mean, truth.mean) for mean in found.mean) <= 4
    assert max(ulps(sd, truth.sd) for sd in found.sd) <= 4
