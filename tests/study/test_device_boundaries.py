"""Curves averaged over the device's posterior, against devices drawn independently."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from percept import Scene, Study
from percept.haptics import Device, Loop
from percept.haptics.perceived import perceived_magnitude
from percept.results import Boundary
from percept.scene import FrequencyTable
from percept.study.boundaries import BoundaryDrawing
from percept.study.device import device_draws

SDS = (0.2, 0.1)  # Of log mass and log damping
RANGE = FrequencyTable(lower=0.1, upper=100.0, points=40)


def drawing(study: Study, covariance: list[list[float]] | None) -> BoundaryDrawing:
    """Boundaries of the study's laws, with a posterior of the device where one is given."""
    setup = study.setup
    assert setup is not None
    draws = None
    if covariance is not None:
        posterior = {"covariance": covariance}
        device = {"mass": 1.0, "damping": 5.0, "period": 1e-3, "posterior": posterior}
        draws = device_draws(Scene(device=device))
    setup = dataclasses.replace(setup, draws=draws)
    return BoundaryDrawing(setup, study.regions, study.curve_laws, RANGE, 0.03)


def curves(drawn: BoundaryDrawing) -> dict[tuple[str, ...], Boundary]:
    """Curves of the laws in two environments."""
    return {
        (one.environment, one.kind, one.method, one.family, one.shape): one
        for one in drawn.drawn(("VE1", "VE3"))
        if one.joint == "joint"
    }


def independent(study: Study, boundary: Boundary, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Curves (M, count) on devices of another generator, and their weights."""
    (law,) = [
        law
        for law in study.curve_laws
        if (law.environment, law.kind, law.method)
        == (boundary.environment, boundary.kind, "bayesian")
    ]
    k, b, weights, _ = law.pair.even(count)
    logs = np.random.default_rng(4).standard_normal((2, count)) * np.array(SDS)[:, None]
    device = Device(np.exp(logs[0]), 5.0 * np.exp(logs[1]))
    magnitude = perceived_magnitude(Loop(device, 1e-3), boundary.omega[:, None], k, b)
    return magnitude, weights / weights.sum()


@pytest.fixture(scope="module")
def averaged(fitted: Study) -> dict[tuple[str, ...], Boundary]:
    return curves(drawing(fitted, np.diag(np.square(SDS)).tolist()))


@pytest.fixture(scope="module")
def at_point(fitted: Study) -> dict[tuple[str, ...], Boundary]:
    return curves(drawing(fitted, None))


def test_limits_hold_their_level_over_other_devices(fitted: Study, averaged, at_point) -> None:
    """At the device's point they hold far less."""
    least = {"averaged": 1.0, "at its point": 1.0}
    for key, boundary in averaged.items():
        if boundary.method == "classical":
            continue
        magnitude, weights = independent(fitted, boundary, 20_000)
        # Weighted points say as much as so many equal ones.
        error = np.sqrt(0.01 * 0.99 * np.sum(weights**2))
        for name, limits in (("averaged", boundary), ("at its point", at_point[key])):
            inside = magnitude >= limits.lower[:, None]
            inside &= magnitude <= limits.upper[:, None]
            at_each = inside @ weights
            least[name] = min(least[name], at_each.mean())
            if name == "averaged" and boundary.shape == "pointwise":
                assert at_each == pytest.approx(np.full(at_each.size, 0.99), abs=4 * error + 0.006)
            elif name == "averaged":
                # Limits far out stand on few of 4,096 points.
                assert inside.all(axis=0) @ weights == pytest.approx(0.99, abs=4 * error + 0.007)
    assert least["averaged"] > 0.988
    assert least["at its point"] < 0.8


def test_a_device_all_but_known_changes_nothing_and_makes_no_share(fitted: Study, at_point) -> None:
    known = curves(drawing(fitted, [[1e-12, 0.0], [0.0, 1e-12]]))
    for key, boundary in at_point.items():
        assert boundary.device_share is None
        # Where Z_h cancels, neighbours in the order of points lie farther apart: within the Monte
        # Carlo error of the limits.
        errors = 0.5 * (boundary.error or 0.0) * np.log(boundary.upper / boundary.lower)
        apart = np.log([known[key].lower / boundary.lower, known[key].upper / boundary.upper])
        assert (np.abs(apart) <= np.maximum(1e-3, errors)).all()
        if boundary.method == "classical":
            assert known[key].device_share is None
        else:
            assert known[key].device_share == pytest.approx(0.0, abs=1e-3)
