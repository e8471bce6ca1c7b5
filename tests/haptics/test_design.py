"""Couplings that qualify: every interval against the forward problem, and the extremes reported."""

import numpy as np
import pytest

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    EnvironmentBoundary,
    Mode,
    TabulatedDevice,
    absolute_stability,
    best_coupling_damping,
    design_couplings,
    magnitude_envelope,
    perceived_impedance,
    required_damping,
)
from percept.haptics.design import Gaps, where_positive

T = 1e-3
OMEGA = np.geomspace(0.1, 100, 40)
DEVICE = Device(1.0, 20.0)
LIMITS = [
    (Environment(1000.0, 1.0), (870.0, 1100.0), (0.9, 1.9)),
    (Environment(10000.0, 10.0), (7800.0, 11100.0), (2.0, 19.0)),
    (Environment(25000.0, 25.0), (21400.0, 26900.0), (14.0, 35.0)),
]
BOUNDARIES = [
    EnvironmentBoundary(environment, *magnitude_envelope(OMEGA, DEVICE, k, b, T))
    for environment, k, b in LIMITS
]


def qualifies(coupling, boundaries):
    ok = np.asarray(required_damping(coupling, T).damping) <= 20.0
    for boundary in boundaries:
        z = np.abs(perceived_impedance(OMEGA[:, None], DEVICE, boundary.environment, T, coupling=coupling))
        ok &= ((z >= boundary.lower[:, None]) & (z <= boundary.upper[:, None])).all(axis=0)
    return ok


@pytest.mark.parametrize(
    "boundaries", [BOUNDARIES[:1], BOUNDARIES[1:2], BOUNDARIES], ids=["soft", "medium", "all"]
)
def test_intervals_are_what_the_forward_problem_says(boundaries):
    rng = np.random.default_rng(6)
    lines = np.array([0.0, 0.5, 5.0, 23.0, 60.0, 110.0, 159.0])
    region = design_couplings(OMEGA, DEVICE, boundaries, T, damping=lines).common
    assert any(len(part) for part in region.intervals)
    for b_c, intervals in zip(region.damping, region.intervals, strict=True):
        ends = intervals.ravel()
        k = np.concatenate([10 ** rng.uniform(1, 6, 3000), ends * (1 - 1e-9), ends * (1 + 1e-9)])
        k = k[k > 0]
        inside = ((k[:, None] >= intervals[:, 0]) & (k[:, None] <= intervals[:, 1])).any(axis=1)
        np.testing.assert_array_equal(inside, qualifies(Coupling(k, b_c), boundaries))


def test_extremes_qualify_and_nothing_beyond_does():
    design = design_couplings(OMEGA, DEVICE, BOUNDARIES, T)
    assert len(design.each) == 3
    rng = np.random.default_rng(7)
    for boundaries, region in [
        *zip(([boundary] for boundary in BOUNDARIES), design.each, strict=True),
        (BOUNDARIES, design.common),
    ]:
        for coupling in (region.largest, region.softest):
            one = Coupling(np.array([coupling.stiffness]), coupling.damping)
            assert qualifies(one, boundaries).all()
        damping = rng.uniform(0, 170, 20_000)
        beyond = qualifies(
            Coupling(region.largest.stiffness * rng.uniform(1.0001, 3, 20_000), damping), boundaries
        )
        assert not beyond.any()
        below = qualifies(
            Coupling(region.softest.stiffness * rng.uniform(0.3, 0.9999, 20_000), damping), boundaries
        )
        assert not below.any()
    # Wide boundaries do not stop the stiffest coupling there is.
    stiffest = 20.0 / best_coupling_damping(1.0, T).device_damping
    assert design.common.largest.stiffness == pytest.approx(stiffest, rel=1e-9)
    assert design.common.softest.stiffness >= max(region.softest.stiffness for region in design.each) * (
        1 - 1e-9
    )


def test_nothing_qualifies_for_a_band_out_of_reach():
    boundary = EnvironmentBoundary(
        BOUNDARIES[0].environment, BOUNDARIES[0].lower * 50, BOUNDARIES[0].upper * 50
    )
    design = design_couplings(OMEGA, DEVICE, [BOUNDARIES[0], boundary], T)
    assert design.each[0].largest is not None
    assert design.each[1].largest is None
    assert design.common.softest is None
    assert all(len(part) == 0 for part in design.common.intervals)


def test_no_limit_leaves_stability_alone():
    free = EnvironmentBoundary(Environment(1000.0, 1.0), np.zeros(40), np.full(40, np.inf))
    region = design_couplings(OMEGA, DEVICE, [free], T, damping=[100.0]).common
    np.testing.assert_allclose(region.intervals[0], [[0.0, 106663.63]], rtol=1e-6)
    assert region.softest.stiffness == 0.0


def test_lines_of_damping_reach_from_nothing_to_the_largest_that_is_stable():
    damping = design_couplings(OMEGA, DEVICE, BOUNDARIES[:1], T).common.damping
    assert damping[0] == 0.0
    assert damping[-1] == pytest.approx(160.0, rel=1e-5)  # 8 times the device's, less a hair
    assert (np.diff(damping) > 0).all()
    # Soft environments qualify at dampings far below the largest.
    assert damping[1] < 1e-3 * damping[-1]


def test_the_stiffest_coupling_of_a_flexible_device_is_marginal():
    device = Device(0.1, 2.0, (Mode(0.05, 3000.0, 0.5),))
    free = EnvironmentBoundary(Environment(1000.0, 2.0), np.zeros(40), np.full(40, np.inf))
    region = design_couplings(OMEGA, device, [free], T, damping=[1.0, 3.0, 6.0]).common
    for b_c, intervals in zip(region.damping, region.intervals, strict=True):
        found = absolute_stability(device, Coupling(intervals[-1, 1], b_c), T)
        # Both searches end where a relative 1e-9 in ω is left, which the margin does not see.
        assert found.smallest_margin == pytest.approx(1.0, abs=1e-10)


def test_flexible_and_tabulated_devices():
    flexible = Device(1.0, 20.0, (Mode(0.05, 2e4, 0.3), Mode(0.02, 5e4, 0.2)))
    region = design_couplings(OMEGA, flexible, BOUNDARIES[1:2], T, damping=[10.0, 30.0, 90.0]).common
    for b_c, intervals in zip(region.damping, region.intervals, strict=True):
        top = intervals[-1, 1]
        assert absolute_stability(flexible, Coupling(top * (1 - 1e-6), b_c), T).verdict == "stable"
        assert absolute_stability(flexible, Coupling(top * (1 + 1e-6), b_c), T).verdict == "unstable"
    omega = np.geomspace(0.05, 3141.0, 200)
    table = TabulatedDevice(omega, 20.0 + 1j * 2 / T * np.tan(omega * T / 2))
    measured = design_couplings(OMEGA, table, BOUNDARIES[1:2], T, damping=[30.0]).common
    rigid = design_couplings(OMEGA, DEVICE, BOUNDARIES[1:2], T, damping=[30.0]).common
    np.testing.assert_allclose(measured.intervals[0], rigid.intervals[0], rtol=1e-3)


def left_over(ceiling, cuts):
    """Slow twin: walk along one line from cut to cut."""
    here, found = 0.0, []
    for low, high in sorted((low, high) for low, high in cuts.tolist() if low == low and high == high):
        if min(low, ceiling) > here:
            found.append((here, min(low, ceiling)))
        here = max(here, high)
    return [*found, (here, ceiling)] if here < ceiling else found


def test_gaps_are_those_found_by_walking_along_each_line():
    rng = np.random.default_rng(8)
    low = np.round(rng.uniform(-2.0, 10.0, (400, 6)), 1)  # rounded, so that ends meet
    cuts = np.stack([low, low + np.round(rng.exponential(1.0, low.shape), 1)], axis=-1)
    cuts[rng.random(low.shape) < 0.3] = np.nan
    cuts[rng.random(low.shape) < 0.05, 1] = np.inf
    cuts[rng.random(low.shape) < 0.05, 0] = -np.inf
    ceiling = np.where(rng.random(400) < 0.1, 0.0, rng.uniform(0.5, 9.0, 400))
    gaps = Gaps.of(ceiling, cuts)
    counts = set()
    for line, (top, own) in enumerate(zip(ceiling.tolist(), cuts, strict=True)):
        expected = left_over(top, own)
        found = gaps.lines()[line]
        np.testing.assert_array_equal(found, np.reshape(expected, (-1, 2)))
        largest, smallest = gaps.costs()[:, line]
        assert largest == (-expected[-1][1] if expected else np.inf)
        assert smallest == (expected[0][0] if expected else np.inf)
        counts.add(len(expected))
    assert counts >= {0, 1, 2, 3}


@pytest.mark.parametrize("a", [2.0, -2.0, 0.0])
def test_where_a_polynomial_is_positive(a):
    values = np.array([-3.0, -0.5, 0.0, 0.5, 3.0])
    half_b, c = (part.ravel() for part in np.meshgrid(values, values))
    k = np.linspace(-40.0, 40.0, 4001) + 1e-4
    positive = a * k**2 + 2 * half_b[:, None] * k + c[:, None] > 0
    found = where_positive(np.full(half_b.shape, a), half_b, c).reshape(-1, 2, 2, 1)
    inside = ((found[:, :, 0] < k) & (k < found[:, :, 1])).any(axis=1)
    np.testing.assert_array_equal(inside, positive)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: design_couplings(OMEGA, DEVICE, [], T), "at least one boundary"),
        (
            lambda: design_couplings(OMEGA[1:], DEVICE, BOUNDARIES, T),
            "a boundary and omega differ in length",
        ),
        (lambda: design_couplings(OMEGA, Device(1.0, [1.0, 2.0]), BOUNDARIES, T), "one device"),
        (lambda: design_couplings([0.0, 1.0], DEVICE, BOUNDARIES, T), "strictly between 0 and Nyquist"),
        (
            lambda: design_couplings([*OMEGA[:-1], np.pi / T], DEVICE, BOUNDARIES, T),
            "strictly between 0 and Nyquist",
        ),
        (
            lambda: design_couplings(OMEGA, DEVICE, BOUNDARIES, T, damping=[]),
            "damping must be a list of one",
        ),
        (
            lambda: design_couplings(OMEGA, DEVICE, BOUNDARIES, T, damping=1.0),
            "damping must be a list of one",
        ),
        (lambda: EnvironmentBoundary(BOUNDARIES[0].environment, ["a"], [1.0]), "limits .* are numbers"),
        (
            lambda: EnvironmentBoundary(Environment(1.0, 1.0), [2.0, 3.0], [3.0, 2.0]),
            "at position 1.*Corner curves cross",
        ),
        (lambda: EnvironmentBoundary(Environment(1.0, 1.0), [0.0, -1.0], [1.0, 1.0]), "at position 1"),
        (lambda: EnvironmentBoundary(Environment(1.0, 1.0), [np.nan], [3.0]), "at position 0"),
        (lambda: EnvironmentBoundary(Environment(1.0, 1.0), [1.0, 2.0], [3.0]), "two arrays of one length"),
        (lambda: EnvironmentBoundary(Environment([1.0, 2.0], 1.0), [1.0], [3.0]), "for one environment"),
    ],
)
def test_wrong_arguments_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()
