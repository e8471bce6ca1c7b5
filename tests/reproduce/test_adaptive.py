import numpy as np
import pytest

from percept.haptics import Coupling, Device, required_damping
from percept.reproduce.adaptive import adapted_couplings, next_user_boundaries, trade_off


@pytest.fixture(scope="module")
def adapted(published):
    return adapted_couplings(published, points=31)


@pytest.fixture(scope="module")
def trade(published):
    return trade_off(published)


def stays_inside(published, device, row, coupling):
    """Eqs 11 and 12 as they stand against the exact envelope by many corners and the nearest point."""
    omega = published.omega(31)
    boundary = next_user_boundaries(published, device, omega)[row]
    wall, period = published.walls[row], published.period
    z = np.exp(1j * omega * period)
    s, zoh = 2 / period * (z - 1) / (z + 1), (z + 1) / (2 * z)
    z_e, z_c = wall.b + wall.k / s, float(coupling.damping) + float(coupling.stiffness) / s
    felt = np.abs(device.mass * s + device.damping + zoh * z_e * z_c / (z_e + z_c))
    return bool(((boundary.lower * (1 - 1e-9) <= felt) & (felt <= boundary.upper * (1 + 1e-9))).all())


def test_the_device_just_carries_the_theoretical_coupling(adapted):
    assert adapted.device.damping == pytest.approx(20.2548, abs=5e-5)


def test_adapted_couplings_are_stable_and_feel_real(published, adapted):
    regions = [*enumerate(adapted.design.each), *((row, adapted.design.common) for row in range(5))]
    for row, region in regions:
        for coupling in (region.softest, region.largest):
            needed = required_damping(coupling, published.period).damping
            assert needed <= adapted.device.damping * (1 + 1e-9)
            assert stays_inside(published, adapted.device, row, coupling), (row, coupling)


def test_softer_than_the_softest_feels_unreal(published, adapted):
    for row, region in enumerate(adapted.design.each):
        soft = region.softest
        if soft.stiffness > 0:
            softer = Coupling(0.98 * float(soft.stiffness), float(soft.damping))
            assert not stays_inside(published, adapted.device, row, softer)


def test_the_tuned_coupling_suits_those_it_suits(published, adapted):
    found = [stays_inside(published, adapted.device, row, published.tuned) for row in range(5)]
    assert list(adapted.static) == found
    assert found == [True, True, True, False, False]


def test_stiffest_stable_is_what_theory_says(trade):
    # The cheapest coupling needs b_d = 0.10695·k_cT.
    np.testing.assert_allclose(trade.stiffest * 0.10695e-3, trade.damping, rtol=5e-5)
    assert trade.static == pytest.approx(15.8384, abs=5e-5)


def test_below_the_least_damping_nothing_stiff_enough_is_stable(published, trade):
    # An environment's softest real coupling against the stiffest stable one: they meet at the least damping.
    for row, least in enumerate(trade.least):
        known = np.isfinite(trade.softest[row])
        if least <= trade.damping[0] or not known.any():
            continue
        assert (trade.damping[known] >= least).all()
        assert (trade.damping[~known] < least).all()
        stiffest = least / 0.10695e-3
        # The softest is searched along 17 lines of b_c, which costs it up to some tenths of a percent.
        assert trade.softest[row][known][0] <= stiffest * 1.005


def test_one_coupling_for_all_needs_what_the_worst_needs(trade):
    assert trade.least_common >= max(trade.least) * (1 - 1e-12)
    assert np.isfinite(trade.least_common)


def test_boundaries_are_of_the_next_user(published):
    # Massless, undamped device at low ω: |Z_h| is k/Ω, and the limits are those of the lognormal prediction.
    omega = np.array([1e-3])
    boundary = next_user_boundaries(published, Device(0.0, 0.0), omega)[1]
    mean, sd = 981.03, 35.200
    spread = np.sqrt(np.log1p((sd / mean) ** 2))
    centre = np.log(mean) - spread**2 / 2
    wanted = np.exp(centre + np.array([-1, 1]) * 3.40846 * spread) / omega
    np.testing.assert_allclose([boundary.lower[0], boundary.upper[0]], wanted, rtol=2e-4)
