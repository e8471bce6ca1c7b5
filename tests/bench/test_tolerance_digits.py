import json
from pathlib import Path

import pytest

from percept.bench import tolerance_digits as bench

#: Factors by another order of integration.
TABLE = Path(__file__).parents[1] / "inference" / "classical" / "tolerance_factors.json"


def test_reference_meets_the_published_and_the_other_integral_from_a_wrong_start():
    rows = {tuple(row[:4]): float(row[4]) for row in json.loads(TABLE.read_text(encoding="utf-8"))}
    wanted = rows["two", 10, 0.99, 0.95]
    assert f"{wanted:.6f}" == "4.436909"
    found = float(bench._exact(10, 0.01, 0.05, 4.4369087))
    # One secant step squares the start's error of 7e-9.
    assert found == pytest.approx(wanted, rel=1e-14)
    assert bench._digits(4.4369087, found) == pytest.approx(8.19, abs=0.02)


def test_digits_are_kept_where_differences_from_one_lose_them():
    (row,) = bench.tolerance_digits(((3, 0.01, 1e-9),))
    assert row.ours > 12.0
    assert row.direct < 9.0
