"""Populations that what a device displays is held against."""

from __future__ import annotations

import numpy as np
from scipy import stats

from percept import Study
from percept.study.posterior import thinned_points
from percept.study.realism import populations


def test_the_level_of_all_users_lies_between_the_limits_of_every_draw(fitted: Study) -> None:
    assert fitted.fit is not None
    model = fitted.fit.prepared.model
    laws = model.laws(thinned_points(fitted.fit)[0])
    for environment, users in populations(fitted.fit, fitted.scene).items():
        for parameter, (low, high) in (("k", users.stiffness), ("b", users.damping)):
            spread = laws.spread[:, model.cells.index((parameter, environment))]
            standard = 0.5 * np.log(high / low) / spread
            # Of normals 99 % lie within z of 0.995.
            np.testing.assert_allclose(standard, stats.norm.ppf(0.995), rtol=1e-9)
