"""Numbers of the claims by other ways: plain arithmetic, dense scans, linear programs, mpmath.

What every claim says is held by its committed page.
"""

import math
import re
from dataclasses import replace

import mpmath
import numpy as np
import pytest
from scipy import optimize, stats

from reports.hbfd import claims_figures as figures
from reports.hbfd import devices
from reports.hbfd.judging import judge, sentences, verdict_of
from tests import DATASETS

HOLDS, ONLY_IF, NOT, OPEN = "holds", "holds only if", "does not hold", "cannot be judged"
T = 1e-3
RANGE = np.geomspace(0.1, 100.0, 20_001)

ENTRIES = {sentence.name: sentence for sentence in sentences()}


def judged(name, published):
    """Judge one claim by another table than the paper's."""
    return judge(published, ENTRIES[name])


def numbers_of(claim):
    """Every number of a claim, by name."""
    return {
        one.name: one.value for one in (*([claim.margin] if claim.margin else []), *claim.numbers)
    }


@pytest.mark.parametrize("name", ENTRIES)
def test_a_condition_stands_where_it_is_needed_and_only_there(name, claims):
    claim = claims[name]
    assert bool(claim.condition) == (claim.verdict in (ONLY_IF, OPEN))
    assert (claim.margin is None) == (claim.verdict == OPEN)
    assert all(math.isfinite(value) for value in numbers_of(claim).values())
    assert claim.place
    assert claim.quote


def test_the_committed_page_has_every_claim_with_its_numbers(claims):
    page = (DATASETS.parent / "reports" / "hbfd" / "hbfd.md").read_text(encoding="utf-8")
    for number, claim in enumerate(claims.values(), start=1):
        told = page.partition(f"### {number}. “{claim.quote}”\n\n")[2].partition("\n##")[0]
        assert told.startswith(f"{claim.place}. **{claim.verdict}**")
        assert claim.condition in told
        assert claim.finding in told
        numbers = [*([claim.margin] if claim.margin else []), *claim.numbers]
        cells = re.findall(r"^\| (.+) \| (.+) \|$", told.replace(r"\|", "|"), re.MULTILINE)
        assert cells[1:] == [(one.name, one.text) for one in numbers]


# The paper's equations once more, in z, with nothing of percept.


def parts(omega):
    """Tustin's s and the averaging hold."""
    z = np.exp(1j * np.asarray(omega) * T)
    return 2 / T * (z - 1) / (z + 1), (z + 1) / (2 * z)


def felt(omega, device, k, b, coupled=False, mass=0.0):
    """|Z_h| by Eqs 11 to 13."""
    s, zoh = parts(omega)
    z_e, z_c = mass * s + b + k / s, 100.0 + 50e3 / s
    return abs(device[0] * s + device[1] + zoh * (z_e * z_c / (z_e + z_c) if coupled else z_e))


def four(omega, device, wall):
    """The four curves of Fig. 7: lower, upper, direct, coupled."""
    ends = [felt(omega, device, k, b) for k, b in zip(wall.stiffness, wall.damping, strict=True)]
    direct, coupled = (felt(omega, device, wall.k, wall.b, how) for how in (False, True))
    return np.minimum(*ends), np.maximum(*ends), direct, coupled


READINGS = {
    "7b": lambda low, high, direct, coupled: (direct < low) & (coupled < low),
    "7d": lambda low, high, direct, coupled: (
        (low <= coupled) & (coupled < direct) & (direct <= high)
    ),
    "7f": lambda low, high, direct, coupled: (coupled < low) & (high < direct),
}
SCENE = (1.0, 5.0)


def test_expected_shares_by_student_s_law(claims):
    # A new user's distance from a mean of n has the variance 1 + 1/n.
    for name, n in (("users-covered", 10), ("thirty-subjects", 30)):
        t = stats.t.ppf(0.995, n - 1)
        share = 1 - 2 * stats.t.sf(t / math.sqrt(n + 1), n - 1)
        last = claims[name].margin.value
        assert last == pytest.approx(share - 0.99, abs=1e-12)
        assert last < 0


def test_a_normal_law_by_its_own_moments(published, claims):
    # Mean and SD behind printed limits: middle, and half-width times √n/t.
    root = math.sqrt(10) / stats.t.ppf(0.995, 9)
    # 4.43691 SDs: the tabled limits for 99 % of users with 95 % confidence, n = 10.
    negative, below = [], []
    for wall in published.walls:
        for name, (low, high) in (("k", wall.stiffness), ("b", wall.damping)):
            mean = (low + high) / 2
            sd = (high - low) / 2 * root
            below.append(stats.norm.cdf(-mean / sd))
            if mean - 4.43691 * sd <= 0:
                negative.append(f"{name} of {wall.name}")
    found = numbers_of(claims["normal-values"])
    assert found["users below zero, b of VE1"] == pytest.approx(max(below), rel=1e-9)
    # No user below zero: none of ten draws of a binomial law.
    none = stats.binom.pmf(0, 10, max(below))
    assert found["studies with no user below zero, b of VE1"] == pytest.approx(none, rel=1e-9)
    assert f"{negative[0]}, {negative[1]} and {negative[2]}" in claims["normal-values"].finding
    assert len(negative) == 3
    over = stats.t.ppf(0.995, 29) / stats.norm.ppf(0.995)
    assert numbers_of(claims["thirty-subjects"])["t over its normal limit"] == pytest.approx(
        over, rel=1e-12
    )


def test_corner_curves_cross_by_a_bisection_in_z(published, claims):
    found = numbers_of(claims["upper-above"])
    for wall in published.walls:

        def gap(omega, wall=wall):
            one, other = (
                felt(omega, SCENE, k, b) for k, b in zip(wall.stiffness, wall.damping, strict=True)
            )
            return other - one

        crossing = optimize.brentq(gap, 0.1, 300.0, xtol=1e-12)
        assert found[f"crossing of {wall.name}"] == pytest.approx(crossing, rel=1e-9)
    assert found["environments whose curves stay apart"] == 2


def test_the_mass_left_out_is_a_root_in_fifty_digits(claims):
    def difference(mass):
        s = 2j / mpmath.mpf("0.001") * mpmath.tan(mpmath.mpf("0.005"))
        z = mpmath.expj(mpmath.mpf("0.01"))
        zoh = (z + 1) / (2 * z)
        z_c, z_e = 100 + 50000 / s, mass * s + 1 + 1000 / s
        lower = mass * s + mpmath.mpf("1.2404") + mpmath.mpf("944.85") / s
        through = z_e * z_c / (z_e + z_c)
        return abs(s + 5 + zoh * lower) - abs(s + 5 + zoh * through)

    found = claims["mass-left-out"].margin.value
    with mpmath.workdps(50):
        root = mpmath.findroot(difference, (found * 0.9999, found * 1.0001))
    assert found == pytest.approx(float(root), rel=1e-10)


def test_shares_of_the_range_by_a_dense_scan(published, claims):
    scanned = {}
    s, _ = parts(RANGE)
    for number, wall in enumerate(published.walls):
        low, high, direct, coupled = four(RANGE, SCENE, wall)
        scanned["reference-inside", f"share, {wall.name}"] = (low <= direct) & (direct <= high)
        below = coupled < abs(wall.b + wall.k / s)
        scanned["always-smaller", f"share of the range, {wall.name}"] = below
        if number < 3:
            name = f"share with |Z_h_vc| inside, {wall.name}"
            scanned["lower-or-medium", name] = (low <= coupled) & (coupled <= high)
    for shown in devices.panels(published):
        true = READINGS[shown.name](*four(RANGE, SCENE, shown.wall))
        scanned["window-suffices", f"share, Fig. {shown.name}"] = true
    for (claim, name), true in scanned.items():
        assert numbers_of(claims[claim])[name] == pytest.approx(true.mean(), abs=2e-4), name


def test_a_model_with_a_mass_by_a_grid_of_its_parameters(published, claims):
    right = []
    for wall in published.walls:
        s, _ = parts(10.0)
        mass = wall.k / abs(s) ** 2
        k = np.linspace(*wall.stiffness, 1001)[:, None]
        b = np.linspace(*wall.damping, 1001)
        every = felt(10.0, (0.0, 0.0), k, b, mass=mass)
        at_low, at_high = every[0, 0], every[-1, -1]
        if wall.name == "VE3":
            found = numbers_of(claims["arbitrary-model"])
            assert found["exact lower limit"] == pytest.approx(every.min(), rel=1e-2)
            assert found["exact upper limit"] == pytest.approx(every.max(), rel=1e-3)
            ratio = claims["arbitrary-model"].margin.value
            assert ratio == pytest.approx(at_low / at_high, rel=2e-3)
        if at_low <= every.min() and at_high >= every.max():
            right.append(wall.name)
    assert right == ["VE1"]
    assert "it is right for VE1." in claims["arbitrary-model"].finding


def linear_program(aim, wall, window, orders, **bounds):
    """Return the largest m or b_d with which curves keep an order: their |Z_h|² differ linearly
    in both."""
    ends = list(zip(wall.stiffness, wall.damping, strict=True))
    shown = {
        "low": ends[0],
        "high": ends[1],
        "direct": (wall.k, wall.b),
        "coupled": (wall.k, wall.b, True),
    }
    rows, sides = [], []
    for omega in np.linspace(*window, 21):
        for below, above in orders:
            free, by_mass, by_damping = (
                felt(omega, device, *shown[below]) ** 2 - felt(omega, device, *shown[above]) ** 2
                for device in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
            )
            # |Z_d|² is common to both and cancels.
            rows.append([by_mass - free, by_damping - free])
            sides.append(-free)
    return -optimize.linprog([-aim, aim - 1], A_ub=rows, b_ub=sides, **bounds).fun


def test_the_devices_of_fig_7b_by_a_linear_program(published, claims):
    panel = devices.panels(published)[0]
    found = numbers_of(claims["fig-7b"])
    orders = [(curve, end) for curve in ("direct", "coupled") for end in ("low", "high")]
    for aim, name in ((1, "largest mass"), (0, "largest device damping")):
        best = linear_program(aim, panel.wall, panel.window, orders, bounds=[(0, None), (0, None)])
        assert found[name] == pytest.approx(best, rel=1e-6)
    # Fig. 4 needs sixteen times as much.
    times = numbers_of(claims["one-device"])["damping Fig. 4 needs over what Fig. 7b allows"]
    assert times == pytest.approx(20.25479906887 / found["largest device damping"], rel=1e-9)


def test_the_masses_of_fig_7d_by_a_linear_program(published, claims):
    panel = devices.panels(published)[1]
    orders = [("low", "coupled"), ("coupled", "direct"), ("direct", "high")]
    limits = [
        linear_program(1, panel.wall, panel.window, orders, bounds=[(0, None), (b, b)])
        for b in (0.0, 50.0)
    ]
    found = numbers_of(claims["fig-7d"])
    assert found["largest mass, least"] == pytest.approx(min(limits), rel=1e-6)
    assert found["largest mass, most"] == pytest.approx(max(limits), rel=1e-6)


def test_the_change_passes_the_band_in_a_part_of_the_window(published, claims):
    panel = devices.panels(published)[0]
    fine = np.linspace(*panel.window, 4001)

    def passed(m, b_d):
        low, high, direct, coupled = four(fine, (m, b_d), panel.wall)
        return (abs(coupled - direct) > high - low).mean()

    found = numbers_of(claims["coupling-unnoticed"])
    part = found["share of the window with the change above the band, largest"]
    mass, damping = found["mass with the largest"], found["damping with the largest"]
    assert passed(mass, damping) == pytest.approx(part, abs=0.01)
    # Off the ridge the change stays below the band.
    low, high, direct, coupled = four(fine, SCENE, panel.wall)
    own = found["largest change over the band at the same ω, scene’s device"]
    assert own == pytest.approx((abs(coupled - direct) / (high - low)).max(), rel=1e-6)
    assert own < 1


def test_effective_stiffness_by_springs_in_series(published, claims):
    # At 10 rad/s dampers carry so little that the springs' own formula is good to five digits.
    found = numbers_of(claims["suits-high"])
    for wall in published.walls:
        series = wall.k * 50e3 / (wall.k + 50e3)
        assert found[f"effective stiffness, {wall.name}"] == pytest.approx(series, rel=1e-4)


# No verdict is written down: a false sentence is judged false, and another table gives another
# verdict.


def test_a_false_sentence_is_judged_false(published):
    # Deliberately false: with the coupling VE4 lies above both boundaries, directly below.
    panel = devices.panels(published)[2]
    upside_down = replace(
        panel,
        reading=lambda shown: (shown.coupled > shown.upper) & (shown.direct < shown.lower),
    )
    assert devices.share_true(published, panel.wall, upside_down.reading) == 0.0
    assert verdict_of(figures._everywhere(published, upside_down)) == NOT


def test_references_inside_wide_limits(published, changed):
    # Walls so stiff that the device's mass is nothing beside them below 100 rad/s.
    stiff = {(wall.name, "k", "reference"): "1e6" for wall in published.walls}
    limits = {"lower": "0.9e6", "upper": "1.1e6"}
    for wall in published.walls:
        for column, text in limits.items():
            stiff[wall.name, "k", column] = text
        for column, text in (("reference", "50"), ("lower", "45"), ("upper", "55")):
            stiff[wall.name, "b", column] = text
    assert judged("reference-inside", changed(stiff)).verdict == HOLDS
    shifted = {cell: text for cell, text in stiff.items() if cell[2] != "reference"}
    soft = {(wall.name, "k", "reference"): "8e5" for wall in published.walls}
    assert judged("reference-inside", changed(shifted | soft)).verdict == NOT


def test_figure_7f_with_a_reference_inside(changed):
    assert judged("fig-7f", changed({("VE4", "k", "upper"): "25100"})).verdict == NOT


def test_figure_7d_with_limits_that_leave_the_coupled_stiffness_out(changed):
    assert judged("fig-7d", changed({("VE2", "k", "lower"): "990"})).verdict != ONLY_IF
    assert judged("fig-7d", changed({("VE2", "k", "lower"): "999"})).verdict == NOT


def test_walls_in_order_throughout_if_they_are_stiff(changed):
    stiff = {}
    for name, k in (("VE1", 100e3), ("VE2", 200e3), ("VE4", 300e3)):
        for column, part in (("reference", 1.0), ("lower", 0.95), ("upper", 1.05)):
            stiff[name, "k", column] = f"{part * k:g}"
    assert judged("like-shapes", changed(stiff)).verdict == HOLDS
