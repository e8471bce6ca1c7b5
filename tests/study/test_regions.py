"""Two shares of users together, and regions that are too large to draw."""

from __future__ import annotations

import numpy as np
from scipy import stats

from percept import Scene, Study
from percept.sessions import Sessions
from tests.study.checked import table_of


def test_two_shares_of_users_together_leave_out_half_as_much_each(fitted: Study) -> None:
    """At 99 % of users with confidence 95 %, each side holds 99.5 % of them with confidence 97.5
    %."""
    assert fitted.fit is not None
    model, rng = fitted.fit.model, np.random.default_rng(1)
    laws = model.moments(np.repeat(fitted.fit.points, 8, axis=0))
    centre = laws.mean + laws.sd * rng.standard_normal(laws.mean.shape)
    found = [
        r
        for r in fitted.regions
        if (r.method, r.joint, r.kind) == ("bayesian", "bonferroni", "share")
    ]
    assert len(found) == 5
    for region in found:
        assert region.limits is not None
        for parameter, ends in zip("kb", region.limits, strict=True):
            cell = model.cells.index((parameter, region.environment))
            low, high = np.log(
                np.array(ends) / fitted.data.reference[parameter, region.environment]
            )
            users = stats.norm(centre[:, cell], laws.population_sd[:, cell])
            held = users.cdf(high) - users.cdf(low) >= 0.995
            # The limits come from the same laws; 12 000 draws of the mean scatter by 0.0015.
            assert abs(held.mean() - 0.975) < 0.012


def test_ellipses_whose_ends_no_double_holds_are_left_out() -> None:
    """Three subjects a factor of exp(1.5) apart: an ellipse of the next user spans hundreds of
    decades."""
    scene = {
        "inference": {"method": "classical"},
        "device": {"mass": 1.0, "damping": 5.0, "period": 1e-3},
        "frequency": {"points": 5},
        "report": {"curves": "all"},
    }
    table = table_of(("k", "b"), subjects=3, s=1.5)
    ellipses = [
        r
        for r in Study(Sessions.from_frame(table), Scene(**scene)).regions
        if r.ellipse is not None
    ]
    assert {(r.kind, r.family) for r in ellipses} == {("mean", "normal"), ("user", "normal")}
    near = Study(
        Sessions.from_frame(table_of(("k", "b"), subjects=3, s=0.01, sigma_u=0.01)), Scene(**scene)
    )
    ellipses = [r for r in near.regions if r.ellipse is not None and r.family == "lognormal"]
    assert {r.kind for r in ellipses} == {"mean", "user"}
