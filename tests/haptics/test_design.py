"""Couplings that qualify: every interval against the forward problem, and the extremes reported."""

import numpy as np
import pytest

from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Mode,
    TabulatedDevice,
    absolute_stability,
    effective_impedance,
    magnitude_envelope,
    perceived_impedance,
    required_damping,
)
from percept.haptics.design import EnvironmentBoundary, design_couplings
from percept.haptics.limits import best_coupling_damping
from tests import LONG

T = 1e-3
RANGE = (0.1, 100.0)
OMEGA = np.geomspace(*RANGE, 3000)
DEVICE = Device(1.0, 20.0)
LIMITS = [
    (Environment(1000.0, 1.0), (870.0, 1100.0), (0.9, 1.9)),
    (Environment(10000.0, 10.0), (7800.0, 11100.0), (2.0, 19.0)),
    (Environment(25000.0, 25.0), (19400.0, 26900.0), (14.0, 35.0)),
]
BOUNDARIES = [EnvironmentBoundary(*one) for one in LIMITS]
FREE = EnvironmentBoundary(Environment(1000.0, 1.0), (-1e30, 1e30), (-1e30, 1e30))


def qualifies(coupling, boundaries, slack=0.0):
    """Say by definition, on a fine grid, which couplings qualify."""
    ok = np.asarray(required_damping(coupling, T).damping) <= 20.0
    for boundary in boundaries:
        own, k, b = boundary.environment, boundary.stiffness, boundary.damping
        lower, upper = magnitude_envelope(OMEGA[:, None], DEVICE, k, b, T)
        z = np.abs(perceived_impedance(OMEGA[:, None], DEVICE, own, T, coupling=coupling))
        ok &= ((z >= lower * (1 - slack)) & (z <= upper * (1 + slack))).all(axis=0)
        for value, (low, high) in zip(
            effective_impedance(OMEGA[:, None], own, coupling, T), (k, b), strict=True
        ):
            ok &= ((value >= low * (1 - slack)) & (value <= high * (1 + slack))).all(axis=0)
    return ok


@pytest.mark.parametrize(
    "boundaries", [BOUNDARIES[:1], BOUNDARIES[1:2], BOUNDARIES], ids=["soft", "medium", "all"]
)
def test_intervals_are_what_the_forward_problem_says(boundaries):
    rng = np.random.default_rng(6)
    lines = np.array([0.0, 0.5, 5.0, 23.0, 60.0, 110.0, 159.0])
    region = design_couplings(DEVICE, boundaries, RANGE, T, damping=lines).common
    assert any(len(part) for part in region.intervals)
    for b_c, intervals in zip(region.damping, region.intervals, strict=True):
        # The outline holds to 0.1 %.
        k = np.concatenate([10 ** rng.uniform(1, 6, 200), intervals.ravel()])
        k = k[k > 0]
        low, high = intervals[:, 0], intervals[:, 1]
        inside = ((k[:, None] >= low) & (k[:, None] <= high)).any(axis=1)
        near = ((k[:, None] >= low * (1 - 1.1e-3)) & (k[:, None] <= high * (1 + 1.1e-3))).any(
            axis=1
        )
        found = qualifies(Coupling(k, b_c), boundaries)
        assert found[inside].all()
        assert not found[~near].any()


COUPLINGS = 500 if LONG else 100


@pytest.mark.evidence(reduced=True)
def test_extremes_qualify_and_nothing_beyond_does():
    design = design_couplings(DEVICE, BOUNDARIES, RANGE, T)
    assert len(design.each) == 3
    rng = np.random.default_rng(7)
    for boundaries, region in [
        *zip(([boundary] for boundary in BOUNDARIES), design.each, strict=True),
        (BOUNDARIES, design.common),
    ]:
        for coupling in (region.largest, region.softest):
            one = Coupling(np.array([coupling.stiffness]), coupling.damping)
            assert qualifies(one, boundaries).all()
        damping = rng.uniform(0, 170, COUPLINGS)
        beyond = Coupling(region.largest.stiffness * rng.uniform(1.001, 3, COUPLINGS), damping)
        below = Coupling(region.softest.stiffness * rng.uniform(0.3, 0.999, COUPLINGS), damping)
        assert not qualifies(beyond, boundaries).any()
        assert not qualifies(below, boundaries).any()
    # Wide boundaries do not stop the stiffest coupling there is.
    stiffest = 20.0 / best_coupling_damping(1.0, T)[1]
    assert design.common.largest.stiffness == pytest.approx(stiffest, rel=1.1e-4)
    assert (
        design.common.softest.stiffness
        >= max(region.softest.stiffness for region in design.each) * 0.999
    )


def test_nothing_qualifies_for_limits_out_of_reach():
    boundary = EnvironmentBoundary(Environment(1000.0, 1.0), (50e3, 60e3), (0.9, 1.9))
    design = design_couplings(DEVICE, [BOUNDARIES[0], boundary], RANGE, T)
    assert design.each[0].largest is not None
    assert design.each[1].largest is None
    assert design.common.softest is None
    assert all(len(part) == 0 for part in design.common.intervals)


def test_the_stiffest_coupling_of_a_flexible_device_is_marginal():
    device = Device(0.1, 2.0, (Mode(0.05, 3000.0, 0.5),))
    region = design_couplings(device, [FREE], RANGE, T, damping=[1.0, 3.0, 6.0]).common
    for b_c, intervals in zip(region.damping, region.intervals, strict=True):
        found = absolute_stability(device, Coupling(intervals[-1, 1] / 0.999, b_c), T)
        # Both searches end where a relative 1e-9 in ω is left, which the margin does not see.
        assert found.smallest_margin == pytest.approx(1.0, abs=1e-10)


def test_flexible_and_tabulated_devices():
    flexible = Device(1.0, 20.0, (Mode(0.05, 2e4, 0.3), Mode(0.02, 5e4, 0.2)))
    region = design_couplings(
        flexible, BOUNDARIES[1:2], RANGE, T, damping=[10.0, 30.0, 90.0]
    ).common
    for b_c, intervals in zip(region.damping, region.intervals, strict=True):
        top = intervals[-1, 1] / 0.999
        assert absolute_stability(flexible, Coupling(top * (1 - 1e-6), b_c), T).verdict == "stable"
        assert (
            absolute_stability(flexible, Coupling(top * (1 + 1e-6), b_c), T).verdict == "unstable"
        )
    omega = np.geomspace(0.05, 3141.0, 200)
    table = TabulatedDevice(omega, 20.0 + 1j * 2 / T * np.tan(omega * T / 2))
    measured = design_couplings(table, BOUNDARIES[1:2], RANGE, T, damping=[30.0]).common
    rigid = design_couplings(DEVICE, BOUNDARIES[1:2], RANGE, T, damping=[30.0]).common
    np.testing.assert_allclose(measured.intervals[0], rigid.intervals[0], rtol=1e-3)
