"""The two forms of the locations' law are the same model."""

import numpy as np
import pytest

from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.information import Information
from percept.inference.hierarchy.orthogonal import factor
from percept.inference.hierarchy.regression import Regression
from percept.inference.hierarchy.scales import Options
from tests.inference.hierarchy import designs


@pytest.fixture(params=["unequal trials", "missing cells", "many patterns", "one environment each"])
def study(request):
    return designs.study(request.param, np.random.default_rng(4))


@pytest.mark.parametrize("subject_effect", [True, False])
def test_density_and_conditional_are_the_same_in_both_forms(study, subject_effect):
    density = CollapsedDensity(study.statistics, options=Options(subject_effect=subject_effect))
    assert density.information is not None
    points = np.random.default_rng(1).normal(size=(30, density.dimension))
    scales = density.layout.scales(np.ascontiguousarray(points.T))
    by_information, law = density(points), density.locations(scales)
    assert isinstance(law, Information)
    density.information = None
    np.testing.assert_allclose(density(points), by_information, rtol=1e-10)
    orthogonal = density.locations(scales)
    for first, second in zip(law.mean, orthogonal.mean, strict=True):
        np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-12)
    for first, second in zip(
        *(one.covariance.diagonal() for one in (law, orthogonal)), strict=True
    ):
        np.testing.assert_allclose(first, second, rtol=1e-8)
    rows = np.random.default_rng(3).normal(size=(2, 2 * len(study.x)))
    for first, second in zip(law.trend(rows), orthogonal.trend(rows), strict=True):
        np.testing.assert_allclose((first**2).sum(axis=0), (second**2).sum(axis=0), rtol=1e-8)


def test_merging_a_single_pattern_changes_nothing():
    density = CollapsedDensity(designs.study("balanced", np.random.default_rng(4)).statistics)
    scales = density.layout.scales(np.random.default_rng(1).normal(size=(density.dimension, 20)))
    found = []
    for merge in (True, False):
        problem = density.regression.whitened(scales, density.cell_noise(scales), merge=merge)
        solved = factor(problem.design, problem.target)
        found.append(
            (
                len(problem.columns),
                problem.log_determinant + solved.log_determinant,
                solved.distance,
            )
        )
    assert found[0][0] == found[1][0] - 2
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-11)
    np.testing.assert_allclose(found[0][2], found[1][2], rtol=1e-10)


def test_a_merged_regression_gives_no_law_of_beta():
    density = CollapsedDensity(designs.study("balanced", np.random.default_rng(4)).statistics)
    scales = density.layout.scales(np.zeros((density.dimension, 2)))
    merged = Regression(density.regression, scales, density.cell_noise(scales), merge=True)
    plain = Regression(density.regression, scales, density.cell_noise(scales))
    np.testing.assert_allclose(merged.log_density, plain.log_density, rtol=1e-10)
    for law in (
        lambda: merged.mean,
        lambda: merged.covariance,
        lambda: merged.draw(np.random.default_rng(1)),
        lambda: merged.trend(np.eye(2)),
    ):
        with pytest.raises(ValueError, match="no law of beta: build it without merge"):
            law()


def test_without_subject_effect_u_is_gone_from_the_population():
    study = designs.study("balanced", np.random.default_rng(3))
    density = CollapsedDensity(study.statistics, options=Options(subject_effect=False))
    scales = density.layout.scales(np.random.default_rng(2).normal(size=(density.dimension, 5)))
    assert scales.shared is None
    for total, within in zip(
        density.population(scales).diagonal(), scales.between.diagonal(), strict=True
    ):
        np.testing.assert_array_equal(total, within)
