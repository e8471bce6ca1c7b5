"""Devices whose impedance is endless somewhere: an undamped mode, and Nyquist."""

from __future__ import annotations

import numpy as np
import pytest

from percept import Scene, Study, read_sessions
from tests import DATASETS

MODE = {"mass": 0.5, "stiffness": 2500.0}  # at 70.7 rad/s


def study(**tables):
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical").to_dict()
    scene["device"]["modes"] = [MODE]
    return Study(read_sessions(DATASETS / "hbfd_sessions.csv"), Scene.from_tables({**scene, **tables}))


@pytest.mark.parametrize("points", [None, 41])
def test_an_undamped_mode_leaves_no_hole_in_the_numbers(points):
    frequency = {"lower": 1.0, "upper": 100.0} | ({"points": points} if points else {})
    found = study(frequency=frequency)
    for boundary in found.boundaries_at(found.frequencies.omega, ("VE3",)) if points else found.boundaries:
        assert np.all(np.diff(boundary.omega) > 0)
        assert not np.isnan([boundary.lower, boundary.upper, boundary.reference]).any()
        if not points:
            assert boundary.departure is not None
            assert np.isfinite([boundary.lower, boundary.upper]).all()
    assert found.coupling is not None
    margins = found.coupling.realism[["margin_uncoupled", "margin_coupled"]].to_numpy(dtype=float)
    assert not np.isnan(margins).any()


def test_at_nyquist_all_curves_are_endless():
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical")
    found = Study(read_sessions(DATASETS / "hbfd_sessions.csv"), scene)
    omega = np.array([1.0, 10.0, 3000.0, np.pi / 1e-3])
    for boundary in found.boundaries_at(omega, ("VE1",)):
        assert np.isinf([boundary.lower[-1], boundary.upper[-1], boundary.reference[-1]]).all()
        assert np.isfinite([boundary.lower[:-1], boundary.upper[:-1]]).all()
