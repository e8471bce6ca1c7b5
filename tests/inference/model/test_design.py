"""Columns of a design, and subjects with trial SDs of their own."""

import numpy as np
import pytest

from percept.inference.model.design import contrast_columns
from percept.inference.model.subject_spreads import SubjectSpreads
from percept.inference.model.trials import trial_scatter
from tests.inference.model.designs import made


def test_subjects_trial_sds_stand_at_their_rough_likelihood():
    """With a wide prior and many trials, ratios of subjects' SDs are those of their scatter."""
    rng = np.random.default_rng(7)
    true = np.array([-0.6, 0.0, 0.2, 0.5])
    subject = np.repeat(np.arange(4), 4000)
    cell = np.tile(np.arange(2), 8000)
    response = np.exp(true[subject] + 0.3 * cell)[:, None] * rng.normal(size=(16000, 1))
    scatter = trial_scatter(response, subject, cell)
    spreads = SubjectSpreads(scatter, 4, 2)
    phi, _ = spreads(np.zeros((1, 4, 1)), np.array([[10.0]]))
    ratios = phi[0, :, 0] - phi[0, :, 0].mean()
    # A log SD from 4,000 trials has a standard error of 1/sqrt(8,000).
    np.testing.assert_allclose(ratios, true - true.mean(), atol=4.0 / np.sqrt(8000.0))
    cells = spreads.cells_given(phi)[0, :, 0]
    np.testing.assert_allclose(cells[1] - cells[0], 0.0, atol=1e-2)


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
