from __future__ import annotations

import numpy as np
import pytest

from percept.haptics._search import local_minima


@pytest.mark.parametrize("place", [0.37, 0.43])
def test_a_minimum_on_either_side_of_the_lowest_point_of_the_grid_is_found(place: float) -> None:
    found = local_minima(lambda x: (x - place) ** 2, np.linspace(0.0, 1.0, 11))
    # A parabola is flat to rounding within the root of a double's digits.
    np.testing.assert_allclose(found, [place], rtol=0, atol=1e-7)
