"""Ends of intervals are judged on the scale of their own interval."""

from __future__ import annotations

import numpy as np

from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.models import IntervalEstimands, Pooled
from tests.inference.hierarchy import designs


def test_kinds_apart_are_all_of_them() -> None:
    model = Pooled(CollapsedDensity(designs.study("balanced", np.random.default_rng(1)).statistics))
    estimands = IntervalEstimands(model)
    components = estimands.components(np.random.default_rng(2).normal(size=(50, len(model.names))))
    whole, influence = estimands.estimate(components)
    apart = [part.estimate(components) for part in estimands.parts()]
    assert whole.names == tuple(name for found, _ in apart for name in found.names)
    assert len(set(whole.names)) == len(whole.value)
    np.testing.assert_array_equal(whole.value, np.concatenate([found.value for found, _ in apart]))
    np.testing.assert_array_equal(influence, np.concatenate([pull for _, pull in apart], axis=1))
    assert estimands.kinds == ("mean", "user", "share")


def test_the_scale_of_both_ends_is_half_the_width() -> None:
    model = Pooled(CollapsedDensity(designs.study("balanced", np.random.default_rng(1)).statistics))
    estimands = IntervalEstimands(model)
    points = np.random.default_rng(2).normal(size=(50, len(model.names)))
    found, _ = estimands.estimate(estimands.components(points))
    # Kinds, ends, cells.
    lower, upper = np.moveaxis(found.value.reshape(3, 2, -1), 1, 0)
    half = 0.5 * (upper - lower)
    assert (half > 0).all()
    np.testing.assert_array_equal(found.scale.reshape(3, 2, -1), np.stack([half, half], axis=1))
