"""Every claim against numbers worked out elsewhere: by hand from Table 1, or from the literature."""

import math

import numpy as np
import pytest

from percept.reproduce import claims_coupling as coupling
from percept.reproduce import claims_figures as figures
from percept.reproduce import claims_table as table
from percept.reproduce import devices

HOLDS, ONLY_IF, NOT = "holds", "holds only if", "does not hold"

# verdict, then numbers by name: the digits printed set the tolerance.
EXPECTED = {
    "fig-4-theoretical": (ONLY_IF, {"damping asked for": "20.2548", "ω that binds": "2022.65"}),
    "fig-4-tuned": (ONLY_IF, {"damping asked for": "15.8384", "ω that binds": "2073.2"}),
    "worst-case": (NOT, {"unstable cases at the limit": "0"}),
    "one-coupling": (
        ONLY_IF,
        {"damping asked for, Eq. 6": "20.2548", "damping asked for, Eq. 12's form": "14.0492"},
    ),
    "substitution": (ONLY_IF, {"printed |s| over the true one": "200.0"}),
    "table-1": (HOLDS, {"limits that agree": "20", "half-width in SDs": "1.02769"}),
    "reference-inside": (ONLY_IF, {"references outside": "6"}),
    "users-covered": (
        NOT,
        {
            "expected share of users": "0.6472",
            "half-width for the mean, SDs": "1.02769",
            "half-width for the share of users, SDs": "4.43691",
        },
    ),
    "thirty-subjects": (NOT, {"t over its normal limit": "1.07"}),
    "normal-values": (ONLY_IF, {"users below zero, b of VE1": "0.139"}),
    "joint-level": (
        ONLY_IF,
        {"joint level, worst case, minus level": "-0.01", "joint level if independent": "0.9801"},
    ),
    "limits-suffice": (ONLY_IF, {}),
    "direct-rendering": (
        ONLY_IF,
        {
            "damping asked for, VE1": "0.105",
            "damping asked for, VE2": "1.5",
            "damping asked for, VE3": "15",
            "damping asked for, VE4": "37.5",
            "damping asked for, VE5": "75",
        },
    ),
    "environments-in-text": (ONLY_IF, {"environments the text lacks": "1"}),
    "mass-left-out": (ONLY_IF, {}),
    "upper-above": (
        ONLY_IF,
        {"crossing of VE1": "11.4", "crossing of VE2": "31.7", "crossing of VE3": "100"},
    ),
    "like-shapes": (ONLY_IF, {}),
    "fig-7b": (ONLY_IF, {"largest device damping": "1.2"}),
    "one-device": (NOT, {"damping Fig. 4 needs": "20.25"}),
    "coupling-unnoticed": (HOLDS, {}),
    "fig-7d": (
        ONLY_IF,
        {
            "effective stiffness": "980.4",
            "largest mass at 10 rad/s, least": "9.3",
            "largest mass at 10 rad/s, most": "9.6",
        },
    ),
    "fig-7f": (HOLDS, {"reference above its upper limit": "0.0013", "effective stiffness": "16667"}),
    "other-environments": (NOT, {"effective stiffness, VE3": "8333", "effective stiffness, VE5": "25001"}),
    "suits-high": (NOT, {}),
    "always-smaller": (ONLY_IF, {"|Z_h_vc| of VE1": "10.3419", "|Z_h| of VE1": "10.3418"}),
    "discrimination": (
        ONLY_IF,
        {
            "relative width of VE1": "1.235",
            "relative width of VE2": "0.072",
            "relative width of VE3": "0.097",
            "relative width of VE4": "0.066",
            "relative width of VE5": "0.167",
        },
    ),
    "magnitude-suffices": (NOT, {"cases inside by magnitude alone": "2"}),
    "window-suffices": (NOT, {}),
    "perceivable-range": (NOT, {"touch beyond the range, lowest": "2.513"}),
    "affects-realism": (HOLDS, {}),
    "felt-and-rendered": (NOT, {}),
}


def test_every_claim_has_its_verdict_tested(claims):
    assert set(claims) == set(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_verdict_and_numbers(name, claims):
    claim = claims[name]
    verdict, numbers = EXPECTED[name]
    assert claim.verdict == verdict
    found = {one.name: one.value for one in (claim.margin, *claim.numbers)}
    for what, printed in numbers.items():
        decimals = len(printed.partition(".")[2])
        assert found[what] == pytest.approx(float(printed), abs=0.5001 * 10.0**-decimals), what


@pytest.mark.parametrize("name", EXPECTED)
def test_a_condition_stands_where_it_is_needed_and_only_there(name, claims):
    claim = claims[name]
    assert bool(claim.condition) == (claim.verdict == ONLY_IF)
    assert math.isfinite(claim.margin.value)
    assert claim.source
    assert claim.place


def test_fig_7b_needs_a_light_device(claims):
    # |Z_h| being a distance in (b, k/Ω), the reference lies below the lower limits without damping as long as
    # b_r² − b_l² − mΩ²T(b_r − b_l) + (k_r² − k_l²)/Ω² − 2m(k_r − k_l) < 0: linear in m, and first lost at the
    # upper end of the window.
    period, omega = 1e-3, 10.11
    rate = 2 / period * math.tan(omega * period / 2)
    b_r, b_l, k_r, k_l = 0.1, 0.0356, 10.0, 10.808
    mass = (b_r**2 - b_l**2 + (k_r**2 - k_l**2) / rate**2) / (
        rate**2 * period * (b_r - b_l) + 2 * (k_r - k_l)
    )
    assert mass == pytest.approx(0.0968, abs=5e-5)
    assert claims["fig-7b"].margin.value == pytest.approx(mass, rel=1e-4)


def test_the_references_left_out_are_those_outside_the_printed_limits(published, claims):
    outside = [
        f"{p} of {wall.name}"
        for wall in published.walls
        for p, value, (low, high) in (("k", wall.k, wall.stiffness), ("b", wall.b, wall.damping))
        if not low <= value <= high
    ]
    finding = claims["reference-inside"].finding
    assert len(outside) == 6
    for name in outside:
        assert name in finding
    assert "b of VE1" in claims["reference-inside"].condition


def test_table_1_is_printed_again(published):
    printed = {
        (name, p): (str(low), str(high))
        for name, lows, highs in zip(
            published.limits.environments, published.limits.lower, published.limits.upper, strict=True
        )
        for p, low, high in zip("kb", lows, highs, strict=True)
    }
    assert {(name, p): (low, high) for name, p, low, high in table.limits_printed(published)} == printed


def test_effective_stiffness_by_springs_in_series(published, claims):
    # At 10 rad/s dampers carry so little that the springs' own formula is good to five digits.
    found = {one.name: one.value for one in claims["other-environments"].numbers}
    for wall in published.walls:
        series = wall.k * 50e3 / (wall.k + 50e3)
        assert found[f"effective stiffness, {wall.name}"] == pytest.approx(series, rel=1e-4)


def test_where_the_order_of_the_curves_ends(published, claims):
    # VE1 and VE2 with a rigid device, averaging hold: equal |Z_h| by plain complex arithmetic.
    omega = np.linspace(20.0, 30.0, 100_001)
    z = np.exp(1j * omega * published.period)
    s = 2 / published.period * (z - 1) / (z + 1)
    one, two = (np.abs(s + 5 + (z + 1) / (2 * z) * (b + k / s)) for k, b in ((10.0, 0.1), (1000.0, 1.0)))
    crossing = omega[np.argmax(one > two)]
    last = claims["like-shapes"].numbers[0].value
    step = (100.0 / 0.1) ** (1 / 240)
    assert last <= crossing <= last * step


def test_the_mass_left_out_is_found_by_a_finer_search(published):
    coarse = table.mass_left_out(published).margin.value
    period, omega = published.period, 10.0
    s = 2j / period * np.tan(omega * period / 2)
    z = np.exp(1j * omega * period)
    zoh, z_c = (z + 1) / (2 * z), 100.0 + 50e3 / s

    def keeps(mass):
        def felt(k, b):
            return abs(s + 5 + zoh * (mass * s + b + k / s))

        z_e = mass * s + 1.0 + 1000.0 / s
        coupled = abs(s + 5 + zoh * z_e * z_c / (z_e + z_c))
        low, high = sorted((felt(944.85, 1.2404), felt(1017.2, 1.5316)))
        return low <= coupled < felt(1000.0, 1.0) <= high

    masses = np.arange(0.0, 20.0, 0.01)
    first_lost = masses[[keeps(mass) for mass in masses].index(False)]
    assert coarse <= first_lost <= coarse * (1e6 ** (1 / 120)) * 1.001


# No verdict is written down: another table, another verdict.


def everywhere(published, limits_of):
    """Limits of every cell, from its reference."""
    return {
        (wall.name, p, column): text
        for wall in published.walls
        for p, value in (("k", wall.k), ("b", wall.b))
        for column, text in zip(("lower", "upper"), limits_of(value), strict=True)
    }


def test_references_inside_wide_limits(published, changed):
    wide = changed(everywhere(published, lambda x: (f"{0.9 * x:.6g}", f"{1.1 * x:.6g}")))
    assert table.reference_inside(wide).verdict == HOLDS
    assert table.normal_values(wide).verdict == HOLDS
    shifted = changed(everywhere(published, lambda x: (f"{1.1 * x:.6g}", f"{1.2 * x:.6g}")))
    assert table.reference_inside(shifted).verdict == NOT


def test_a_misprinted_limit_is_no_t_interval(changed):
    # More digits than a double has cannot come back.
    odd = changed({("VE1", "k", "lower"): "10.80800000000000000001"})
    assert table.reprinted(odd).verdict == ONLY_IF


def test_users_covered_follows_the_number_of_subjects(changed):
    shares = [table.users_covered(changed(n=n)).numbers[0].value for n in (5, 10, 20, 30, 100)]
    assert shares == pytest.approx([0.8667, 0.6472, 0.4601, 0.3757, 0.2056], abs=5e-5)


def test_thirty_subjects_depends_on_what_was_done(changed):
    assert table.thirty_subjects(changed(n=30)).verdict == ONLY_IF


def test_figure_7f_with_a_reference_inside(changed):
    assert figures.high_impedance(changed({("VE4", "k", "upper"): "25100"})).verdict == NOT


def test_figure_7d_with_limits_that_leave_the_coupled_stiffness_out(changed):
    assert figures.middle_impedance(changed({("VE2", "k", "lower"): "990"})).verdict != ONLY_IF
    assert figures.middle_impedance(changed({("VE2", "k", "lower"): "999"})).verdict == NOT


def test_figure_7b_with_the_reference_inside(published, changed):
    inside = changed({("VE1", "k", "lower"): "9"})
    light = (np.array(0.01), np.array(0.05))
    before, after = (
        devices.over_devices(each, devices.panels(each)[0], *light) for each in (published, inside)
    )
    assert before
    assert not after


def test_one_device_for_both_figures_if_free_motion_felt_stiffer(changed):
    stiff = {("VE1", "k", "lower"): "9000", ("VE1", "k", "upper"): "9900"}
    damped = {("VE1", "b", "lower"): "900", ("VE1", "b", "upper"): "990"}
    assert figures.one_device(changed(stiff | damped)).verdict != NOT


def test_other_environments_inside(changed):
    wide = {
        ("VE3", "k", "lower"): "8000",
        ("VE5", "k", "lower"): "24000",
    }
    assert coupling.other_environments(changed(wide)).verdict == HOLDS


def test_coupling_at_high_impedance_inside_its_limits(changed):
    assert coupling.suits_high(changed({("VE5", "k", "lower"): "24000"})).verdict == ONLY_IF


def test_discrimination_with_widths_in_proportion(published, changed):
    cells = {}
    for wall, share in zip(published.walls, (0.01, 0.02, 0.03, 0.04, 0.05), strict=True):
        for p, value in (("k", wall.k), ("b", wall.b)):
            cells[wall.name, p, "lower"] = f"{value * (1 - share):.8g}"
            cells[wall.name, p, "upper"] = f"{value * (1 + share):.8g}"
    assert figures.discrimination(changed(cells)).verdict == HOLDS


def test_magnitude_is_enough_where_both_parameters_are_inside(changed):
    wide = {("VE2", "b", "lower"): "0.5"}
    assert figures.magnitude_suffices(changed(wide)).verdict == HOLDS


def test_text_and_table_agree_once_the_table_repeats_the_text(changed):
    repeated = {("VE2", "k", "reference"): "10", ("VE2", "b", "reference"): "0.1"}
    assert table.environments_in_text(changed(repeated)).verdict == HOLDS


def test_soft_walls_are_passive_without_a_coupling(published, changed):
    soft = {(wall.name, "k", "reference"): "100" for wall in published.walls}
    soft |= {(wall.name, "b", "reference"): "0.1" for wall in published.walls}
    assert coupling.direct_rendering(changed(soft)).verdict == HOLDS


def test_realism_survives_if_no_reference_was_inside(published, changed):
    far = changed(everywhere(published, lambda x: (f"{5 * x:.6g}", f"{5.1 * x:.6g}")))
    assert coupling.affects_realism(far).verdict == NOT
