import sys

import numpy as np
import pytest

from percept.bench.soak import slope, soak
from percept.errors import UsageError


def test_slope_of_a_leak_is_found_with_its_error_and_the_start_is_left_out():
    rng = np.random.default_rng(2)
    seconds = np.arange(0.0, 3600.0, 10.0)
    errors = []
    for _ in range(200):
        memory = 500.0 + 3.0 * seconds / 3600.0 + rng.normal(0.0, 1.0, seconds.size)
        memory[:60] -= 200.0  # while it was starting
        found = slope(seconds, memory, "memory", "MB")
        errors.append((found.per_hour - 3.0) / found.error)
    assert found.mean == pytest.approx(500 + 3 * 0.625, abs=0.3)
    # Standardised errors of 200 slopes: mean within 4/sqrt(200), SD within four of its standard errors.
    assert abs(np.mean(errors)) < 4 / np.sqrt(200)
    assert abs(np.std(errors) - 1) < 4 / np.sqrt(400)


def test_too_short_a_series_is_said():
    with pytest.raises(UsageError, match="at least three values"):
        slope([0.0, 1.0], [1.0, 2.0], "memory", "MB")


@pytest.mark.skipif(sys.platform == "win32", reason="open files are counted on POSIX")
def test_a_short_soak_sees_the_batch_and_its_workers(monkeypatch):
    pytest.importorskip("distributed", reason="needs the extra percept[cluster]")
    monkeypatch.setattr("percept.bench.soak._BATCH", 2)
    found = soak(0.02, workers=1, every=0.2, tolerance=0.5)
    series = {one.name: one for one in found.slopes}
    assert found.studies >= 2
    assert found.studies % 2 == 0
    assert series["processes"].mean > 1.5  # this one, and the worker under its nanny
    assert series["memory of the process that hands out"].mean > 50
    assert series["memory of the workers"].mean > 50
    assert series["open files"].mean > 10
