"""Which couplings are stable with how many devices, and maps that count it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from percept import Scene, Study, haptics
from percept.haptics import Coupling
from percept.study.device import Setup
from percept.study.device_draws import device_draws
from percept.study.maps import coupling_map
from percept.study.stable_couplings import StableCouplings, is_stable

MODE = {"mass": 0.2, "stiffness": 8e3, "damping": 2.0}
SD = 0.1


def setup_of(study: Study, modes=()) -> Setup:
    posterior = {"parameters": ["damping"], "covariance": [[SD**2]]}
    device = {"mass": 1.0, "damping": 5.0, "period": 1e-3, "modes": modes, "posterior": posterior}
    scene = Scene(device=device)
    setup = study.parts.setup
    assert setup is not None
    at_point = haptics.Device(1.0, 5.0, tuple(haptics.Mode(**mode) for mode in modes))
    return dataclasses.replace(setup, device=at_point, draws=device_draws(scene))


@pytest.mark.parametrize("modes", [[], [MODE]])
def test_probabilities_are_shares_of_stable_devices(fitted: Study, modes) -> None:
    setup = setup_of(fitted, modes)
    stable = StableCouplings.of(setup)
    damping = np.array([1.0, 8.0, 20.0])
    stiffness = 0.9 * stable.limit(damping)
    found = stable.probability(stiffness, damping)
    for index in range(damping.size):
        coupling = Coupling(stiffness[index], damping[index])
        judged = []
        for draw in range(stable.devices):
            alone = dataclasses.replace(setup, device=setup.draws.device(draw), draws=None)
            judged.append(is_stable(alone, coupling))
        # Limits are interpolated between dampings: one device may lie at the edge.
        assert abs(found[index] - np.mean(judged)) <= 1.0 / stable.devices
        assert stable.allows(coupling, found[index])
        assert not stable.allows(coupling, found[index] + 0.001)


def test_devices_that_agree_leave_an_error_of_one_device(fitted: Study) -> None:
    stable = StableCouplings.of(setup_of(fitted))
    chance = stable.chance(Coupling(1.0, 8.0))
    assert chance.probability == 1.0
    assert chance.error == 1.0 / stable.devices


def test_one_device_is_certain(fitted: Study) -> None:
    setup = dataclasses.replace(setup_of(fitted), draws=None)
    stable = StableCouplings.of(setup)
    assert stable.devices is None
    assert stable.chance(Coupling(1.0, 8.0)).error == 0.0
    damping = np.array([8.0])
    limit = stable.limit(damping)
    assert stable.probability(0.999 * limit, damping) == 1.0
    assert stable.allows(Coupling(0.999 * limit[0], 8.0), 0.95)
    assert not stable.allows(Coupling(1.001 * limit[0], 8.0), 0.95)


def test_an_admissible_coupling_is_stable_and_real_with_the_decision(fitted: Study) -> None:
    users = {"VE1": fitted.parts.users["VE1"]}
    scene = fitted.scene.with_inference(decision=0.6)
    setup = setup_of(fitted)
    with_draws = coupling_map(setup, users, "bayesian", scene, fitted.parts.within)
    setup_at_point = dataclasses.replace(setup, draws=None)
    at_point = coupling_map(setup_at_point, users, "bayesian", scene, fitted.parts.within)
    assert with_draws is not None
    assert at_point is not None
    assert with_draws.devices == 64
    assert at_point.devices is None
    (found,) = with_draws.environments
    (point,) = at_point.environments
    stiffest = found.stiffest
    assert stiffest is not None
    assert point.stiffest is not None
    assert stiffest.probability >= 0.6
    stable = StableCouplings.of(setup)
    chance = stable.probability(np.array([stiffest.stiffness]), np.array([stiffest.damping]))
    assert stiffest.probability <= chance[0]
    # Half of the devices do not stand the stiffest coupling that the point does.
    assert stiffest.stiffness < point.stiffest.stiffness
    assert found.stiffness.max() > point.stiffness.max()
