from __future__ import annotations

import numpy as np
import pytest

from percept.haptics._gaps import Gaps, where_positive


def left_over(ceiling: float, cuts: np.ndarray) -> list[tuple[float, float]]:
    """Slow twin: walk along one line from cut to cut."""
    here, found = 0.0, []
    for low, high in sorted((low, high) for low, high in cuts.tolist() if low == low and high == high):
        if min(low, ceiling) > here:
            found.append((here, min(low, ceiling)))
        here = max(here, high)
    return [*found, (here, ceiling)] if here < ceiling else found


def test_gaps_are_those_found_by_walking_along_each_line() -> None:
    rng = np.random.default_rng(8)
    low = np.round(rng.uniform(-2.0, 10.0, (400, 6)), 1)  # rounded, so that ends meet
    cuts = np.stack([low, low + np.round(rng.exponential(1.0, low.shape), 1)], axis=-1)
    cuts[rng.random(low.shape) < 0.3] = np.nan
    cuts[rng.random(low.shape) < 0.05, 1] = np.inf
    cuts[rng.random(low.shape) < 0.05, 0] = -np.inf
    ceiling = np.where(rng.random(400) < 0.1, 0.0, rng.uniform(0.5, 9.0, 400))
    gaps = Gaps.of(ceiling, cuts)
    counts = set()
    for line, (top, own) in enumerate(zip(ceiling.tolist(), cuts, strict=True)):
        expected = left_over(top, own)
        found = gaps.lines()[line]
        np.testing.assert_array_equal(found, np.reshape(expected, (-1, 2)))
        largest, smallest = gaps.costs()[:, line]
        assert largest == (-expected[-1][1] if expected else np.inf)
        assert smallest == (expected[0][0] if expected else np.inf)
        counts.add(len(expected))
    assert counts >= {0, 1, 2, 3}


@pytest.mark.parametrize("a", [2.0, -2.0, 0.0])
def test_where_a_polynomial_is_positive(a: float) -> None:
    values = np.array([-3.0, -0.5, 0.0, 0.5, 3.0])
    half_b, c = (part.ravel() for part in np.meshgrid(values, values))
    k = np.linspace(-40.0, 40.0, 4001) + 1e-4
    positive = a * k**2 + 2 * half_b[:, None] * k + c[:, None] > 0
    found = where_positive(np.full(half_b.shape, a), half_b, c).reshape(-1, 2, 2, 1)
    inside = ((found[:, :, 0] < k) & (k < found[:, :, 1])).any(axis=1)
    np.testing.assert_array_equal(inside, positive)
