"""Simulation-based calibration, reduced: right densities stay inside, wrong ones are caught.

The full run is `make calibrate`; its results are committed under reports/calibration.
"""

import dataclasses
import itertools

import numpy as np
import pytest

from percept.inference.model.design import design_of
from percept.inference.model.model import LinearModel
from reports.calibration.fits import place_study, written
from reports.calibration.uniformity import (
    EcdfBand,
    Plan,
    calibrate,
    ecdf_band,
    judge_places,
)
from tests import LONG

PLAN = Plan(kind="one environment")


def judged(plan, placed):
    return judge_places(plan.kind, plan.bins, placed)


def placed_at(values):
    return {"reason": "", "values": values}


def failed(reason):
    return {"reason": reason, "values": {}}


def uniform_places(count, names, seed=0):
    rng = np.random.default_rng(seed)
    return [placed_at(dict(zip(names, rng.random(len(names)), strict=True))) for _ in range(count)]


@pytest.mark.evidence(reduced=True)
def test_right_density_stays_inside():
    fits = 100 if LONG else 3
    found = calibrate(PLAN, place_study, fits)
    assert found.reasons == ()
    assert found.fits == fits
    assert found.outside == []
    names = {one.quantity.split("[")[0] for one in found.quantities}
    assert names == {"sigma", "rho_w", "mean", "user"}


class WithoutJacobian(LinearModel):
    """The prior of log sigma taken as a density of sigma squared: wrong by twice the sum of log
    sigma."""

    def __call__(self, points):
        limits = self.coordinates.limits
        sigma = self.scales(np.clip(points, -limits, limits))["sigma"][1]
        return super().__call__(points) + 2.0 * np.log(sigma).reshape(len(points), -1).sum(axis=1)


def without_jacobian(model):
    return WithoutJacobian(model.statistics, model.design, model.priors)


def with_a_narrow_prior(model):
    priors = dataclasses.replace(model.priors, log_s_sd=0.1 * model.priors.log_s_sd)
    design = design_of(model.design.cells, model.design.factors, priors)
    return LinearModel(model.statistics, design, priors)


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize(
    "density", [with_a_narrow_prior, without_jacobian] if LONG else [with_a_narrow_prior]
)
def test_wrong_density_is_caught(density):
    fits = range(40 if LONG else 4)
    found = judged(PLAN, [placed_at(place_study(PLAN, index, density)) for index in fits])
    assert any(name.startswith("sigma") for name in found.outside)


def test_uniform_values_pass_and_one_bent_quantity_is_named():
    names = [f"sigma[k,VE{j}]" for j in range(1, 31)]
    placed = uniform_places(300, names)
    assert judged(PLAN, placed).outside == []
    bent = [
        placed_at({**one["values"], "sigma[k,VE7]": one["values"]["sigma[k,VE7]"] ** 1.6})
        for one in placed
    ]
    assert judged(PLAN, bent).outside == ["sigma[k,VE7]"]


def test_the_error_is_shared_among_the_quantities():
    found = judged(PLAN, uniform_places(100, [f"q{i}" for i in range(30)]))
    assert found.tail == ecdf_band(100, PLAN.bins, 0.01 / 30).tail


def test_failed_fits_are_counted_with_their_reason():
    placed = [*uniform_places(40, ["tau[k]"]), failed("the ensembles disagree."), failed("stuck.")]
    found = judged(PLAN, placed)
    assert found.reasons == ("the ensembles disagree.", "stuck.")
    assert found.row[:6] == ["one environment", 42, 2, 1, 0, "tau[k]"]
    nothing = judged(PLAN, [failed("stuck.")])
    assert nothing.row[:6] == ["one environment", 1, 1, 0, 0, ""]


def test_the_page_says_what_is_wrong():
    right = judged(PLAN, uniform_places(50, ["rho_w", "mean[k,1]"]))
    wrong = judge_places(
        "a wrong model", PLAN.bins, [placed_at({"tau": 0.01 * i}) for i in range(20)]
    )
    made = written([right], [wrong])
    assert "at most 1 %" in made.text
    assert "| one environment | 50 | 0 | 2 | 0 | " in made.text
    assert "| a wrong model | 20 | 0 | 1 | 1 | tau | " in made.text
    assert made.right
    assert not written([right], [right]).right
    assert not written([wrong]).right


def test_probability_equals_enumeration():
    """All ways to put 6 values into 4 bins, each with its multinomial probability."""
    band = EcdfBand(6, 4, 0.2)
    inside = 0
    for bins in itertools.product(range(4), repeat=6):
        below = np.cumsum(np.bincount(bins, minlength=4))[:3]
        inside += np.all((below >= band.lower) & (below <= band.upper))
    assert abs(band.probability() - inside / 4**6) < 1e-13


def test_a_band_is_as_wide_as_stated_but_for_whole_counts():
    band = ecdf_band(400, 20, 0.01)
    assert 0.99 <= band.probability() < 0.994
    assert EcdfBand(400, 20, 1.2 * band.tail).probability() < 0.99


def test_counts_and_tails_by_hand():
    band = EcdfBand(4, 2, 0.5)
    values = np.array([0.1, 0.5, 0.9, 0.2])
    judged = band.judge("u", values)
    assert judged.below == (2,)  # a value on an edge is not below it
    assert judged.least_tail == 1.0
    assert band.judge("u", np.array([0.9, 0.8, 0.7, 0.6])).least_tail == pytest.approx(2 / 16)
