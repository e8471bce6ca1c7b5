"""Users of an environment nobody was tested in: draws of their spread, and limits from them."""

from __future__ import annotations

import numpy as np

from percept.inference.model.predictions import new_environment
from tests.inference.model.designs import made

PLACE = np.array([0.3, -0.4])


def model_and_points(width=5):
    study = made("plain")
    return study.model, study.points(width, spread=1.0)


def expected(model, points, repeats):
    found = new_environment(model, points, PLACE, repeats=repeats, rng=np.random.default_rng(0))[""]
    return found, {
        name: np.repeat(values, repeats, axis=0)
        for name, (_, values) in model.scales(points).items()
    }


def test_spreads_of_stiffness_and_damping_leave_their_trends_independently() -> None:
    found, named = expected(*model_and_points(width=200), repeats=20)
    own = np.diagonal(found.users[:, 0], axis1=1, axis2=2) - named["sigma_u"] ** 2
    off = (0.5 * np.log(own) - np.log(named["s"]) - named["kappa"] * PLACE) / named["omega"]
    # Where next to nothing leaves the trend the difference is rounding.
    off = off[(named["omega"] > 0.1).all(axis=1)]
    assert len(off) > 2000
    # A correlation of independent pairs scatters by one over the root of their number.
    assert abs(np.corrcoef(off.T)[0, 1]) < 4.0 / np.sqrt(len(off))
