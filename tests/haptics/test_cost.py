"""The cost measurement measures what it says; how fast it is stays out of the tests."""

from percept.bench.haptics import magnitude_cost


def test_scratch_is_small_beside_the_result():
    cost = magnitude_cost(omegas=100, environments=5, draws=4000, repeats=1)
    assert cost.result_bytes == 100 * 5 * 4000 * 8
    assert cost.scratch_bytes < cost.result_bytes / 8
    assert cost.ratio == cost.seconds / cost.hypot_seconds
