"""Ends of intervals are judged on the scale of their own interval."""

from __future__ import annotations

import numpy as np

from percept.inference.model.limits import Limits
from tests.inference.model.designs import made


def test_the_scale_of_both_ends_is_half_the_width() -> None:
    model = made("plain").model
    estimands = Limits(model)
    points = np.random.default_rng(2).normal(size=(50, len(model.names)))
    names = []
    for found, _ in estimands.estimates(estimands.components(points)):
        # Ends, cells.
        lower, upper = found.value.reshape(2, -1)
        half = 0.5 * (upper - lower)
        assert (half > 0).all()
        np.testing.assert_array_equal(found.scale.reshape(2, -1), [half, half])
        names += found.names
    assert len(set(names)) == len(names) == 6 * len(model.cells)
