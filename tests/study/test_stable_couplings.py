"""Which couplings are stable with how many devices, and maps that count it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from percept import Scene, Study, haptics
from percept.haptics import Coupling
from percept.study.device import Setup, device_draws
from percept.study.maps import coupling_map
from percept.study.rendering import StableCouplings
from percept.study.verdicts import MapUsers

MODE = {"mass": 0.2, "stiffness": 8e3, "damping": 2.0}
SD = 0.1


def setup_of(study: Study, modes=(), damping=5.0) -> Setup:
    posterior = {"parameters": ["damping"], "covariance": [[SD**2]]}
    device = {"mass": 1.0, "damping": damping, "period": 1e-3, "modes": modes}
    device["posterior"] = posterior
    scene = Scene(device=device)
    setup = study.setup
    assert setup is not None
    at_point = haptics.Device(1.0, damping, tuple(haptics.Mode(**mode) for mode in modes))
    return dataclasses.replace(setup.with_device(at_point), draws=device_draws(scene))


@pytest.mark.parametrize("modes", [[], [MODE]])
def test_probabilities_are_shares_of_devices_that_render(fitted: Study, modes) -> None:
    """Of devices with modes the damping alone counts, which is on the safe side."""
    setup = setup_of(fitted, modes)
    stable = StableCouplings(setup, ["VE3", "VE4"])
    damping = np.array([1.0, 3.0, 5.0])
    stiffness = 0.9 * stable.limit(damping)
    found = stable.probability(stiffness, damping)
    dampings = np.asarray(setup.draws.damping)
    for index in range(damping.size):
        coupling = Coupling(stiffness[index], damping[index])
        needed = [
            haptics.needed_damping(setup.loop, setup.references[name], coupling=coupling).damping
            for name in ("VE3", "VE4")
        ]
        assert found[index] == np.mean(dampings > max(needed))


@pytest.mark.parametrize("modes", [[], [MODE]])
def test_one_device_is_certain(fitted: Study, modes) -> None:
    setup = dataclasses.replace(setup_of(fitted, modes), draws=None)
    stable = StableCouplings(setup, ["VE4"])
    assert stable.devices is None
    damping = np.array([2.0])
    limit = stable.limit(damping)
    assert stable.probability(0.999 * limit, damping) == 1.0
    assert stable.probability(1.001 * limit, damping) == 0.0


def test_an_admissible_coupling_is_stable_and_real_with_the_decision(fitted: Study) -> None:
    # With 13 of the 15 N·s/m that VE3 needs directly stability bounds its couplings.
    users = {"VE3": fitted.users["VE3"]}
    scene = fitted.scene.with_inference(decision=0.6)
    setup = setup_of(fitted, damping=13.0)
    with_draws = coupling_map(setup, MapUsers(users, "bayesian"), scene)
    setup_at_point = dataclasses.replace(setup, draws=None)
    at_point = coupling_map(setup_at_point, MapUsers(users, "bayesian"), scene)
    assert with_draws is not None
    assert at_point is not None
    assert with_draws.devices == setup.draw_count
    assert at_point.devices is None
    (found,) = with_draws.environments
    (point,) = at_point.environments
    stiffest = found.stiffest
    assert stiffest is not None
    assert point.stiffest is not None
    assert stiffest.probability >= 0.6
    stable = StableCouplings(setup, list(users))
    chance = stable.probability(np.array([stiffest.stiffness]), np.array([stiffest.damping]))
    assert stiffest.probability <= chance[0]
    # Half of the devices do not stand the stiffest coupling that the point does.
    assert stiffest.stiffness < point.stiffest.stiffness
    assert found.stiffness.max() > point.stiffness.max()
