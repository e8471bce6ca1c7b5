"""The two forms of the location regression are the same model."""

import numpy as np
import pytest

from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.least_squares import factor
from percept.inference.hierarchy.scales import Options
from tests.inference.hierarchy import designs


@pytest.fixture(params=["balanced", "k only", "unequal trials", "missing cells", "many patterns"])
def density(request):
    return CollapsedDensity(designs.study(request.param, np.random.default_rng(4)).statistics)


def both_forms(density, scales, **options):
    for form in (True, False):
        density.regression.by_environment = form
        yield density.regression.build(scales, density.cell_blocks(scales), **options)


def test_density_is_the_same_in_both_forms(density):
    points = np.random.default_rng(1).normal(size=(30, density.dimension))
    values = []
    for form in (True, False):
        density.regression.by_environment = form
        values.append(density(points))
    np.testing.assert_allclose(*values, rtol=1e-11)


def test_merging_a_single_pattern_changes_nothing():
    density = CollapsedDensity(designs.study("balanced", np.random.default_rng(4)).statistics)
    scales = density.layout.scales(np.random.default_rng(1).normal(size=(density.dimension, 20)))
    found = []
    for merge in (True, False):
        problem = density.regression.build(scales, density.cell_blocks(scales), merge=merge)
        solved = factor(problem.design, problem.target)
        found.append(
            (len(problem.columns), problem.log_determinant + solved.log_determinant, solved.distance)
        )
    assert found[0][0] == found[1][0] - 2
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-11)
    np.testing.assert_allclose(found[0][2], found[1][2], rtol=1e-10)


def test_conditional_is_the_same_in_both_forms(density):
    scales = density.layout.scales(np.random.default_rng(2).normal(size=(density.dimension, 10)))
    laws = []
    for form in (True, False):
        density.regression.by_environment = form
        laws.append(density.locations(scales))
    for first, second in zip(laws[0].mean, laws[1].mean, strict=True):
        np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-12)
    for first, second in zip(*(law.covariance.diagonal() for law in laws), strict=True):
        np.testing.assert_allclose(first, second, rtol=1e-9)


def test_the_form_with_fewer_latents_is_taken():
    rng = np.random.default_rng(0)
    few = CollapsedDensity(designs.study("balanced", rng).statistics)
    many = CollapsedDensity(designs.study("many patterns", rng).statistics)
    assert not few.regression.by_environment
    assert len(many.statistics.patterns) > len(many.statistics.environments)
    assert many.regression.by_environment
    for density in (few, many):
        scales = density.layout.scales(rng.normal(size=(density.dimension, 2)))
        chosen = density.regression.by_environment
        sizes = dict(zip((True, False), (len(p.columns) for p in both_forms(density, scales)), strict=True))
        assert sizes[chosen] == min(sizes.values())


def test_without_subject_effect_u_is_gone_from_the_population():
    study = designs.study("balanced", np.random.default_rng(3))
    density = CollapsedDensity(study.statistics, options=Options(subject_effect=False))
    scales = density.layout.scales(np.random.default_rng(2).normal(size=(density.dimension, 5)))
    assert scales.shared is None
    for total, within in zip(density.population(scales).diagonal(), scales.between.diagonal(), strict=True):
        np.testing.assert_array_equal(total, within)
