"""Weights to wider priors against the dense twin's densities under both."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Options
from percept.inference.hierarchy.wider_priors import reweighted, wider, with_priors
from tests.inference.hierarchy import dense_twin, designs

OPTIONS = [Options(), Options(weber=True), Options(subject_effect=False, common_spread=True)]


@pytest.mark.parametrize("options", OPTIONS, ids=["whole", "weber", "small"])
@pytest.mark.parametrize("name", designs.NAMES)
def test_weights_are_ratios_of_posteriors(name: str, options: Options) -> None:
    study = designs.study(name, np.random.default_rng(11))
    old = Priors(omega_scale=0.7, omega_e_scale=0.4, kappa_sd=0.3, rho_shape=3.0)
    density = CollapsedDensity(study.statistics, old, options)
    new = wider(old)
    points = np.random.default_rng(12).standard_normal((6, len(density.names)))
    scales = density.layout.scales(np.ascontiguousarray(points.T))
    wide = with_priors(density, new)
    assert wide.priors == new
    likelihood = wide.log_likelihood(scales) - density.log_likelihood(scales)
    found = reweighted(density, points)[0]
    wanted = [
        change
        + dense_twin.log_prior(scales.named, study.x, w, new)
        - dense_twin.log_prior(scales.named, study.x, w, old)
        for w, change in enumerate(likelihood)
    ]
    # A constant is free.
    np.testing.assert_allclose(found - found[0], np.array(wanted) - wanted[0], rtol=1e-9, atol=1e-9)


def test_all_widths_grow_by_a_quarter_and_no_centre_moves() -> None:
    old, new = Priors(), wider(Priors())
    for field in dataclasses.fields(Priors):
        before, after = getattr(old, field.name), getattr(new, field.name)
        if field.name.endswith("_mean"):
            assert after == before
        elif field.name == "rho_shape":
            assert after - 1.0 == pytest.approx((before - 1.0) / 1.25**2, rel=1e-15)
        else:
            assert after == pytest.approx(1.25 * before, rel=1e-15)


def test_locations_are_those_under_the_wider_priors() -> None:
    """Priors narrow enough to pull: the laws of the cells move when these are widened."""
    study = designs.study("balanced", np.random.default_rng(11))
    density = CollapsedDensity(study.statistics, Priors(alpha_sd=0.1, gamma_sd=0.1, tau_scale=0.05))
    points = np.random.default_rng(12).standard_normal((4, len(density.names)))
    scales = density.layout.scales(np.ascontiguousarray(points.T))
    wide, own = (one.moments(scales).pack() for one in (with_priors(density, wider(density.priors)), density))
    np.testing.assert_allclose(reweighted(density, points)[1], wide, rtol=1e-12)
    assert np.abs(wide - own).max() > 0.001
