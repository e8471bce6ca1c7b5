"""Devices drawn from a scene's posterior, and what they render with every passive hand."""

import dataclasses

import numpy as np
import pytest
from scipy import special

from percept import Scene, UsageError, haptics
from percept.study.device import device_draws
from percept.study.rendering import device_stability, margins_of_draws

# Through the coupling this needs 15.0 N·s/m.
LOOP = haptics.Loop(haptics.Device(1.0, 5.0), 1e-3)
WALL = haptics.Environment(12e3, 11.0)
COUPLING = haptics.Coupling(50e3, 100.0)
MODE = {"mass": 0.2, "stiffness": 8e3, "damping": 2.0}


def scene(posterior, **device):
    return Scene(
        device={"mass": 1.0, "damping": 16.0, "period": 1e-3, **device, "posterior": posterior}
    )


def test_draws_have_the_posteriors_moments():
    covariance = [[0.01, -0.01], [-0.01, 0.04]]
    draws = device_draws(scene({"covariance": covariance}))
    logs = np.log([draws.mass, draws.damping])
    # Sobol's points err far less than as many independent ones, whose error of a mean this is.
    assert logs.mean(axis=1) == pytest.approx(np.log([1.0, 16.0]), abs=0.2 / np.sqrt(512))
    assert np.cov(logs) == pytest.approx(np.array(covariance), abs=0.002)


def test_stability_of_a_rigid_device_is_a_normal_distribution_function():
    sd = 0.05
    draws = device_draws(scene({"parameters": ["damping"], "covariance": [[sd**2]]}))
    needed = haptics.needed_damping(LOOP, WALL, coupling=COUPLING).damping
    found = device_stability(draws, LOOP, WALL, COUPLING)
    exact = special.ndtr((np.log(16.0) - np.log(needed)) / sd)
    assert found.probability == pytest.approx(exact, abs=found.error)


@pytest.mark.parametrize("delay", [0.0, 1.0])
def test_margins_of_modal_devices_are_those_of_each_alone(delay):
    posterior = {
        "parameters": ["damping", "mode 1 stiffness", "mode 1 damping"],
        "covariance": np.diag([0.04, 0.01, 0.25]).tolist(),
    }
    draws = device_draws(scene(posterior, modes=[MODE]))
    found = margins_of_draws(draws, dataclasses.replace(LOOP, delay=delay), WALL, COUPLING)
    assert found.size == 256
    for index in range(0, found.size, 64):
        alone = haptics.can_render(
            haptics.Loop(draws.select(index), 1e-3, delay=delay), WALL, coupling=COUPLING
        )
        # The frequencies are not refined: they miss a minimum by less than this.
        assert found[index] == pytest.approx(alone.margin, rel=2e-3)


def test_few_draws_of_a_modal_device_are_all_judged(tmp_path):
    file = tmp_path / "draws.csv"
    file.write_text("mass,damping\n1,1\n1,40\n", encoding="utf-8")
    draws = device_draws(scene({"draws": str(file)}, modes=[MODE]))
    assert sorted(margins_of_draws(draws, LOOP, WALL, COUPLING) > 1.0) == [False, True]


def test_draws_of_a_file(tmp_path):
    file = tmp_path / "draws.csv"
    file.write_text("mass,damping\n1,10\n1,20\n1,30\n1,40\n", encoding="utf-8")
    draws = device_draws(scene({"draws": str(file)}))
    assert sorted(draws.damping) == [10.0, 20.0, 30.0, 40.0]
    assert device_stability(draws, LOOP, WALL, COUPLING).probability == 0.75
    for text, message in (
        ("mass\n1\n", "There is no column 'damping'; there are mass"),
        (
            "mass,damping\n1,1\n1,x\n",
            "draws.csv:3, column 'damping', value 'x': must be a positive",
        ),
        ("mass,damping\n", "has 0 draws; a posterior needs 2 or more"),
        ("mass,damping\n1,1\n", "has 1 draws; a posterior needs 2 or more"),
    ):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(UsageError) as error:
            device_draws(scene({"draws": str(file)}))
        assert message in str(error.value)
    with pytest.raises(UsageError, match="cannot be read"):
        device_draws(scene({"draws": "nowhere.csv"}))


def test_without_a_posterior_there_are_none():
    device = {"mass": 1.0, "damping": 16.0, "period": 1e-3}
    assert device_draws(Scene(device=device)) is None
    assert device_draws(Scene()) is None


@pytest.mark.parametrize(
    ("posterior", "device", "message"),
    [
        ({}, {}, "give covariance or draws, one of them"),
        ({"covariance": [[1.0]]}, {}, "must have 2 rows and columns"),
        ({"covariance": [[1.0, 0.5], [0.4, 1.0]]}, {}, "must be symmetric"),
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, {}, "must be positive definite"),
        ({"parameters": ["spring"], "covariance": [[1.0]]}, {}, "posterior names 'spring'"),
        ({"parameters": ["mass"], "covariance": [[1.0]]}, {"mass": 0.0}, "mass is zero"),
        (
            {"covariance": [[1.0, 0.0], [0.0, 1.0]]},
            {"mass": None, "damping": None, "response": "zd.csv"},
            "a measured response has no posterior",
        ),
    ],
)
def test_what_is_refused(posterior, device, message):
    with pytest.raises(UsageError, match=message):
        scene(posterior, **device)
