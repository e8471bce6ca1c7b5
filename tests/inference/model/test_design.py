"""Columns of a design, and subjects with trial SDs of their own."""

import numpy as np
import pytest

from percept.inference.model.design import contrast_columns
from tests.inference.model.designs import made


@pytest.mark.parametrize("levels", [2, 3, 5])
def test_every_difference_of_levels_has_the_prior_of_two(levels):
    columns = contrast_columns(levels)
    np.testing.assert_allclose(columns.sum(axis=0), 0.0, atol=1e-12)
    for first in range(levels):
        for second in range(first):
            apart = columns[first] - columns[second]
            assert apart @ apart == pytest.approx(1.0)
    np.testing.assert_allclose(contrast_columns(2)[:, 0], [-0.5, 0.5])


def test_an_interaction_has_the_prior_of_a_difference():
    """Differences of differences have prior SD one, and so has each main effect."""
    model = made("two by two, spread").model
    terms = {term.name: term.columns for term in model.design.fixed}
    corners = np.array([1.0, -1.0, -1.0, 1.0])
    assert terms["hand:load"][:, 0, :4] @ corners == pytest.approx(1.0)
    assert terms["hand"][:, 0, :4] @ [-0.5, -0.5, 0.5, 0.5] == pytest.approx(1.0)
