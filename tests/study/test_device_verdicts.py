"""Verdicts over the device's posterior, against every device judged on a grid of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from percept import Study
from percept.boundary.feels_real import plane_scores, search_scores
from percept.boundary.shares import score_of
from percept.haptics import Coupling
from percept.study.device import device_draws
from percept.study.rendering import margins_of_draws
from percept.study.verdicts import frequencies, relative_sd, study_verdicts

COUPLING = Coupling(15e3, 20.0)
CENTRAL = 0.9
DAMPING = 20.0


def known(study: Study, covariance: list[list[float]]):
    """The study's setup, with a device of 20 N·s/m and its posterior, and its scene."""
    device = {"mass": 1.0, "damping": DAMPING, "period": 1e-3}
    posterior = {"covariance": covariance}
    scene = study.scene.with_tables(
        device=device | {"posterior": posterior},
        verdict={"central": CENTRAL},
        inference={"method": "bayesian"},
    )
    setup = study.setup
    assert setup is not None
    setup = setup.with_device(dataclasses.replace(setup.loop.device, damping=DAMPING))
    changed = dataclasses.replace(setup, draws=device_draws(scene), coupling=COUPLING)
    return changed, scene


@pytest.mark.parametrize("coupled", [True, pytest.param(False, marks=pytest.mark.evidence)])
def test_each_device_is_judged_at_its_own_frequencies(fitted: Study, coupled: bool) -> None:
    """At the point device's frequencies the probability was .02 too large, and nothing decided."""
    setup, scene = known(fitted, [[0.25, 0.0], [0.0, 0.25]])
    weights = {"VE2": np.ones((100, 1))}  # Of fewer draws than are judged
    users = fitted.users["VE2"].select(slice(0, 256))
    verdicts = study_verdicts(
        setup, {"VE2": users}, fitted.subjects, scene, stable={}, weights=weights
    )
    (verdict,) = [row for row in verdicts if row.coupled is coupled]
    evidence = verdict.bayesian
    assert evidence is not None
    spread = relative_sd(users)
    inside = []
    for index in range(evidence.draws):
        one = setup.with_device(setup.draws.select(index))
        display = one.display("VE2", coupled=coupled)
        user = users.select(slice(index, index + 1))
        omega = frequencies(one, "VE2", spread, scene)
        dense = np.union1d(omega, omega[[0]] * (omega[-1] / omega[0]) ** np.linspace(0, 1, 100))
        score = search_scores(display, user, dense, np.array([score_of(CENTRAL)])).largest[0]
        plane = plane_scores(display, user, dense[0], dense[-1])[0]
        inside.append(max(score, plane) <= score_of(CENTRAL))
    # Of the same draws, one or two may lie too near to the edge.
    assert evidence.probability == pytest.approx(np.mean(inside), abs=2.0 / evidence.draws)
    assert verdict.without == pytest.approx((np.mean(inside[:100]),), abs=2.0 / 100)


def test_a_coupling_is_stable_and_real_on_the_same_devices(fitted: Study) -> None:
    setup, scene = known(fitted, [[0.25, 0.0], [0.0, 16.0]])
    users = {"VE1": fitted.users["VE1"]}
    verdicts = study_verdicts(setup, users, fitted.subjects, scene, stable={}, weights={})
    (verdict,) = [row for row in verdicts if row.coupled]
    evidence = verdict.bayesian
    assert evidence is not None
    shown = setup.references["VE1"], COUPLING
    margins = margins_of_draws(setup.draws, setup.loop, *shown)
    share = float(np.mean(margins[: evidence.draws] > 1.0))
    assert 0.8 < share < 0.95
    # Nothing ties what can be rendered to how it feels.
    expected = share * evidence.probability
    assert verdict.stable_and_real == pytest.approx(expected, abs=3.0 * evidence.error)
