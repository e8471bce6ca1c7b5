import re
from importlib.resources import files

import numpy as np
import pytest

from percept.bench.classical import coverage, digits_kept, number_accuracy, small_large
from percept.inference import subject_means

NIST = files("scipy.stats").joinpath("tests", "data", "nist_anova")
shipped = pytest.mark.skipif(not NIST.is_dir(), reason="this SciPy was installed without its test data")


def nist(name):
    """Return responses, treatments and the certified SD within treatments of a one-way set."""
    text = NIST.joinpath(f"{name}.dat").read_text(encoding="ascii")
    certified = float(re.search(r"Certified Residual\s+Standard Deviation\s+(\S+)", text)[1])
    treatment, response = np.array([line.split() for line in text.splitlines()[60:] if line.strip()]).T
    return response.astype(float), treatment, certified


@pytest.fixture(scope="module")
def rows():
    return digits_kept(long=200_000)


def test_every_mean_and_sd_is_the_correctly_rounded_one(rows):
    assert {row.ulps for row in rows} == {0.0}
    assert len(rows) == 2 * 4 + 9 + 2 * 6 + 2


def test_sums_of_squares_lose_what_percept_keeps(rows):
    direct = {(row.name, row.quantity): row.direct for row in rows}
    assert direct["NumAcc1", "mean"] == 16.0
    assert direct["SmLs01", "sd"] > 12
    # squares of 1e6 hold their last digit at 1e-4: of an SD of 0.1 two digits are left, of offset 1e12 none
    assert direct["SmLs04", "sd"] < 4
    assert direct["SmLs07", "sd"] < 1
    assert direct["huge", "sd"] == direct["offset 1e15", "sd"] == direct["constant 0.1", "sd"] == 0.0


def test_certified_values_are_met_as_far_as_doubles_can(rows):
    certified = {(row.name, row.quantity): row for row in rows if row.kept is not None}
    assert len(certified) == 17
    for row in certified.values():
        assert row.kept == row.possible
    assert all(certified[f"NumAcc{i}", "mean"].kept == 16.0 for i in (1, 2, 3, 4))
    # decimal data of offset 10⁷ are off by up to 1e-9 as doubles, which leaves 8 digits of an SD of 0.1
    assert certified["NumAcc4", "sd"].kept == pytest.approx(8.25, abs=0.01)
    assert certified["SmLs03", "sd"].kept > 15


@shipped
@pytest.mark.parametrize("which", range(1, 10))
def test_the_small_large_sets_are_nists(which):
    response, treatment, certified = nist(f"SmLs0{which}")
    values, group, sd = small_large(which)
    assert values.tolist() == response.tolist()
    assert (group + 1).astype(str).tolist() == treatment.tolist()
    assert sd == certified


@shipped
@pytest.mark.parametrize("name", ["AtmWtAg", "SiRstv"])
def test_the_observed_one_way_sets(name):
    response, treatment, certified = nist(name)
    found = subject_means(response, treatment).trial_sd
    # printed to 15 digits; the decimal data are rounded to doubles, one part in 2**53 of their size
    rounding = np.abs(response).max() * 2.0**-53 / certified
    assert abs(found / certified - 1.0) <= 1e-14 + rounding


def test_number_accuracy_has_its_size():
    assert [number_accuracy(i)[0].size for i in (1, 2, 3, 4)] == [3, 1001, 1001, 1001]


def test_each_kind_covers_what_it_says_and_the_misreading_does_not():
    found = coverage(studies=10_000)
    assert len(found) == 2 * 4 * 3 * 4
    for row in found:
        assert abs(row.held - row.theory) <= 4 * row.error, row
    misread = [row for row in found if row.statement == "mean read as users"]
    assert all(row.stated - row.held > 20 * row.error for row in misread if row.n >= 5)
    at_ten = [row for row in misread if row.n == 10]
    assert all(row.theory == pytest.approx(0.6472, abs=5e-5) for row in at_ten)
