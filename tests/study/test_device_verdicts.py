"""Verdicts averaged over the device's posterior, against every device judged in full."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from percept import Scene, Study
from percept.boundary.feels_real import feels_real, judge
from percept.haptics import Coupling
from percept.study.device_draws import device_draws, smallest_margins
from percept.study.device_verdicts import with_device_draws
from percept.study.verdicts import frequencies, relative_sd

#: A coupling that half of the devices make stable.
COUPLING = Coupling(15e3, 20.0)


def known(study: Study, covariance: list[list[float]]):
    """The study's setup with a posterior of the device, and a stable coupling."""
    scene = Scene(
        device={
            "mass": 1.0,
            "damping": 5.0,
            "period": 1e-3,
            "posterior": {"covariance": covariance},
        }
    )
    setup = study.parts.setup
    assert setup is not None
    return dataclasses.replace(setup, draws=device_draws(scene), coupling=COUPLING)


@pytest.mark.parametrize("coupled", [pytest.param(False, marks=pytest.mark.evidence), True])
def test_the_average_is_that_of_every_device_judged_in_full(fitted: Study, coupled) -> None:
    setup = known(fitted, [[0.25, 0.0], [0.0, 0.04]])
    (verdict,) = [
        row for row in fitted.verdicts if row.environment == "VE2" and row.coupled is coupled
    ]
    users = fitted.parts.users["VE2"]
    omega = frequencies(setup, "VE2", relative_sd(users), fitted.parts.within)
    some = users.select(slice(0, 128))
    display = setup.display("VE2", coupled=coupled)
    at_point = feels_real(display, some, omega, level=0.99, decision=0.95)
    evidence = dataclasses.replace(verdict.bayesian, probability=at_point.probability)
    found = with_device_draws(
        dataclasses.replace(verdict, bayesian=evidence), setup, users, omega, 0.95
    )
    average = found.by_device
    assert average is not None
    in_full = []
    for index in range(average.devices):
        other = dataclasses.replace(display, device=setup.draws.device(index))
        in_full.append(feels_real(other, some, omega, level=0.99, decision=0.95).probability)
    # Both take the same devices; the draws of the users differ.
    error = np.hypot(average.error, at_point.error)
    assert abs(average.probability - np.mean(in_full)) < 4.0 * error
    assert found.probability == average.probability
    assert found.outcome == judge(average.probability, 0.95)
    whole = average.probability * (1.0 - average.probability)
    assert average.share == pytest.approx(np.var(in_full) / whole, abs=0.1)
    if coupled:
        margins = smallest_margins(setup.draws, COUPLING, setup.period, setup.hold)
        stable = np.mean(margins >= 1.0)
        assert 0.0 < stable < 1.0
        # Stability needs damping, and what feels real hardly depends on it.
        assert found.stable_and_real == pytest.approx(stable * average.probability, abs=0.1)
    else:
        assert found.stable_and_real is None


def test_a_device_that_is_known_changes_nothing(fitted: Study) -> None:
    setup = known(fitted, [[1e-20, 0.0], [0.0, 1e-20]])
    verdict = fitted.verdicts[2]
    users = fitted.parts.users[verdict.environment]
    omega = frequencies(setup, verdict.environment, relative_sd(users), fitted.parts.within)
    found = with_device_draws(verdict, setup, users, omega, 0.95)
    assert found.by_device is not None
    assert found.probability == verdict.probability
    assert found.by_device.share == 0.0
    # That 16 devices move none of 64 users is known to one user.
    one_user = 1.0 / (16 * 64)
    assert found.by_device.error == pytest.approx(np.hypot(verdict.bayesian.error, one_user))
    without = dataclasses.replace(setup, draws=None)
    assert with_device_draws(verdict, without, users, omega, 0.95) is verdict
