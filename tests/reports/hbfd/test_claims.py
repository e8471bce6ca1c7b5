"""Every verdict against a computation of its own: plain arithmetic, dense scans, linear
programs, mpmath."""

import itertools
import math
from dataclasses import replace

import mpmath
import numpy as np
import pytest
from scipy import optimize, stats

from reports.hbfd import claims_figures as figures
from reports.hbfd import claims_table as table
from reports.hbfd import devices
from reports.hbfd.claims_coupling import cheapest_damping
from reports.hbfd.judging import judge, sentences, verdict_of

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


@pytest.mark.parametrize(("k", "b", "form"), [(110e3, 100, 0), (50e3, 100, 0), (110e3, 100, 1)])
def test_damping_asked_for_by_a_scan(k, b, form, claims):
    omega = np.linspace(1.0, np.pi / T - 1e-6, 100_001)
    z, (tustin, zoh) = np.exp(1j * omega * T), parts(omega)
    admittance = 1 / (b + k / (tustin if form else (z - 1) / (T * z)))
    asked = (1 - np.cos(np.angle(zoh))) * abs(zoh) / (2 * admittance.real)
    found = numbers_of(
        claims["one-coupling" if form else f"fig-4-{'theoretical' if k > 6e4 else 'tuned'}"]
    )
    name = "damping asked for, Eq. 12's form" if form else "damping asked for"
    assert found[name] == pytest.approx(asked.max(), rel=1e-7)
    if not form:
        assert found["ω that binds"] == pytest.approx(omega[asked.argmax()], abs=0.05)


def test_the_damping_with_which_a_stiffness_asks_for_least():
    coupling, device = cheapest_damping(1.0)
    assert f"{coupling:.4g}" == "0.1248"
    assert f"{device:.5g}" == "0.10695"


@pytest.mark.parametrize("name", ["VE1", "VE2", "VE3", "VE4", "VE5"])
def test_damping_for_direct_rendering_by_colgate_s_integrand(name, published, claims):
    wall = next(wall for wall in published.walls if wall.name == name)
    theta = np.linspace(1e-3, np.pi, 100_001)
    z = np.exp(1j * theta)
    rendered = wall.k + wall.b * (z - 1) / (T * z)
    asked = T / 2 / (1 - np.cos(theta)) * ((1 - 1 / z) * rendered).real
    found = numbers_of(claims["direct-rendering"])[f"damping asked for, {name}"]
    assert found == pytest.approx(asked.max(), rel=1e-5)


def test_expected_shares_by_student_s_law(claims):
    # A new user's distance from a mean of n has the variance 1 + 1/n.
    for name, n in (("users-covered", 10), ("thirty-subjects", 30)):
        t = stats.t.ppf(0.995, n - 1)
        share = 1 - 2 * stats.t.sf(t / math.sqrt(n + 1), n - 1)
        last = claims[name].margin.value
        assert last == pytest.approx(share - 0.99, abs=1e-12)
        assert last < 0


def test_the_references_left_out_are_those_outside_the_printed_limits(published, claims):
    outside = [
        f"{p} of {wall.name}"
        for wall in published.walls
        for p, value, (low, high) in (("k", wall.k, wall.stiffness), ("b", wall.b, wall.damping))
        if not low <= value <= high
    ]
    assert len(outside) == 6
    assert all(name in claims["reference-inside"].finding for name in outside)
    assert "b of VE1" not in claims["reference-inside"].finding


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


def test_widths_at_ten_by_plain_arithmetic(published, claims):
    s, _ = parts(10.0)
    widths = numbers_of(claims["discrimination"])
    for wall in published.walls:
        ends = [abs(b + k / s) for k, b in zip(wall.stiffness, wall.damping, strict=True)]
        assert widths[f"width of {wall.name}"] == pytest.approx(ends[1] - ends[0], rel=1e-9)
        assert widths[f"relative width of {wall.name}"] == pytest.approx(
            (ends[1] - ends[0]) / abs(wall.b + wall.k / s), rel=1e-9
        )


def test_dampers_inside_by_magnitude_by_a_scan(published, claims):
    found = numbers_of(claims["magnitude-suffices"])
    for wall in published.walls:
        low, high, *_ = four(10.0, SCENE, wall)
        dampers = np.arange(0.0, 6000.0, 0.01)
        magnitudes = felt(10.0, SCENE, 0.0, dampers)
        inside = dampers[(low <= magnitudes) & (magnitudes <= high)]
        name = f"damper that passes for {wall.name}, least"
        assert (name in found) == bool(inside.size)
        if inside.size:
            assert found[name] == pytest.approx(inside[0], abs=0.0101)
            # It has none of the wall's stiffness, and its damping is far from the wall's limits.
            assert not wall.damping[0] <= found[name] <= wall.damping[1]


def test_limits_made_at_random_come_out_of_table_1_too(changed, claims, published):
    rng = np.random.default_rng(5)
    cells = {}
    for wall in published.walls:
        for p in "kb":
            low, high = np.sort(rng.uniform(1.0, 5e4, 2))
            cells[wall.name, p, "lower"], cells[wall.name, p, "upper"] = f"{low:.5g}", f"{high:.5g}"
    random = judged("table-1", changed(cells))
    assert {one.name: one.value for one in random.numbers}["limits that agree"] == 20
    assert random.verdict == claims["table-1"].verdict == OPEN
    assert "each subject" in random.condition


def test_where_the_order_of_the_four_curves_ends_on_a_fine_grid(claims, published):
    omega = np.geomspace(0.1, 100.0, 400_001)
    walls = sorted((wall for wall, _ in published.drawn), key=lambda wall: wall.k)
    ordered = np.ones(omega.size, dtype=bool)
    for soft, stiff in itertools.pairwise(walls):
        for below, above in zip(four(omega, SCENE, soft), four(omega, SCENE, stiff), strict=True):
            ordered &= below < above
    assert omega[ordered.argmin()] == pytest.approx(
        claims["like-shapes"].numbers[0].value, rel=2e-5
    )
    assert ordered.mean() == pytest.approx(claims["like-shapes"].margin.value, abs=1e-5)


def test_the_mass_left_out_is_a_root_in_fifty_digits(published, claims):
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
    wall, masses = published.walls[1], np.arange(0.0, 12.0, 1e-3)
    ends = [
        felt(10.0, SCENE, k, b, mass=masses)
        for k, b in zip(wall.stiffness, wall.damping, strict=True)
    ]
    direct, coupled = (felt(10.0, SCENE, wall.k, wall.b, how, masses) for how in (False, True))
    kept = READINGS["7d"](np.minimum(*ends), np.maximum(*ends), direct, coupled)
    first = masses[kept.argmin()]
    assert first - 1e-3 <= found <= first
    assert found == pytest.approx(float(root), rel=1e-10)


@pytest.mark.parametrize("panel", [0, 1, 2])
def test_readings_over_the_range_by_a_dense_scan(panel, published, claims):
    shown = devices.panels(published)[panel]
    found = numbers_of(claims["window-suffices"])
    curves = four(RANGE, SCENE, shown.wall)
    true = READINGS[shown.name](*curves)
    assert found[f"share, Fig. {shown.name}"] == pytest.approx(true.mean(), abs=2e-4)
    if shown.name == "7d":
        inside = (curves[0] <= curves[3]) & (curves[3] <= curves[1])
        assert claims["window-suffices"].margin.value == pytest.approx(inside.mean(), abs=2e-4)


@pytest.mark.parametrize("panel", [0, 1, 2])
def test_the_least_ratio_of_the_four_lines_by_devices_at_random(panel, published, claims):
    shown = devices.panels(published)[panel]
    name = f"least ratio, Fig. 7{'ace'[panel]}"
    found = numbers_of(claims["four-lines"])[name]
    rng = np.random.default_rng(3)
    tried = (rng.uniform(0, 30, 20_000), rng.uniform(0, 50, 20_000))
    lines = np.array(four(10.0, tried, shown.wall))
    ratios = lines.max(axis=0) / lines.min(axis=0)
    # The page's devices lie on a grid, these between them.
    assert ratios.min() == pytest.approx(found, abs=6e-3)
    # Six decades on 60 mm: a ratio is its logarithm times ten millimetres.
    hidden = 10 * math.log10(found) <= 0.35
    assert hidden == (f"Fig. 7{'ace'[panel]}" in claims["four-lines"].condition)


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


def test_the_true_hold_by_its_own_transfer_function(claims):
    omega = np.linspace(1.0, np.pi / T, 100_001)
    s = 1j * omega
    true = (1 - np.exp(-s * T)) / (s * T)
    z = np.exp(s * T)
    z_c = 100.0 + 110e3 / ((z - 1) / (T * z))
    asked = (1 - np.cos(np.angle(true))) * abs(true) / (2 * (1 / z_c).real)
    found = numbers_of(claims["hold-low-pass"])
    assert found["damping asked for, true hold"] == pytest.approx(asked.max(), rel=1e-6)
    assert claims["hold-low-pass"].margin.value == pytest.approx(asked.max() / 20.2548, rel=1e-5)
    _, average = parts(RANGE)
    s = 1j * RANGE
    gain = 1 - abs(average) / abs((1 - np.exp(-s * T)) / (s * T))
    assert found["gains in the range, largest difference"] == pytest.approx(gain.max(), rel=1e-6)


def test_a_coupling_without_end_by_plain_arithmetic(published, claims):
    s, zoh = parts(RANGE)
    gaps = []
    for wall in published.walls:
        z_e = wall.b + wall.k / s
        z_c = 1e3 * (100.0 + 50e3 / s)
        device = s + 5.0
        coupled = device + zoh * z_e * z_c / (z_e + z_c)
        gaps.append(abs(coupled / (device + zoh * z_e) - 1).max())
    found = numbers_of(claims["coupling-to-infinity"])
    assert found["largest difference, times 1,000"] == pytest.approx(max(gaps), rel=1e-3)
    assert claims["coupling-to-infinity"].margin.value == pytest.approx(1000, rel=0.01)


def decay(wall, steps=4000):
    """Return the factor per sample by which device and wall, released, come to rest (Eqs 5, 7,
    8)."""
    mass, damping = SCENE
    position, velocity, device, rendered = 0.0, 1.0, 0.0, 0.0
    heights = []
    for _ in range(steps):
        # F_d + (F_e + F_e of the sample before)/2 = 0, both by Tustin's rule, solved for the
        # velocity.
        inertia = 2 * mass / T
        stiff = wall.b + wall.k * T / 2
        known = -device - inertia * velocity + damping * velocity
        known += (wall.k * (position + T / 2 * velocity) + rendered) / 2
        after = -known / (inertia + damping + stiff / 2)
        device = -device + inertia * (after - velocity) + damping * (after + velocity)
        position += T / 2 * (after + velocity)
        rendered = wall.k * position + wall.b * after
        velocity = after
        heights.append(velocity**2 + wall.k * position**2)
    # Energies at one phase of the motion: their largest in two stretches, half the run apart.
    half = steps // 2
    first = max(heights[half // 2 : half])
    last = max(heights[half + half // 2 :])
    return (last / first) ** (0.5 / half)


@pytest.mark.parametrize("row", range(5))
def test_the_poles_without_a_hand_by_letting_go(row, published, claims):
    wall = published.walls[row]
    found = numbers_of(claims["direct-rendering"])[f"largest pole without a hand, {wall.name}"]
    assert found == pytest.approx(decay(wall), abs=2e-4)
    assert found < 1


def test_what_eq_10_asks_for_at_ten_no_mass_like_device_of_fig_7b_has(published, claims):
    found = numbers_of(claims["one-device"])
    z, (_, zoh) = np.exp(10j * T), parts(10.0)
    admittance = 1 / (100.0 + 110e3 / ((z - 1) / (T * z)))
    asked = (1 - np.cos(np.angle(zoh))) * abs(zoh) / (2 * admittance.real)
    assert found["damping Fig. 4 needs at 10 rad/s"] == pytest.approx(asked, rel=1e-6)
    # Any device at 10 rad/s alone, its reactance that of a mass: the window shrinks to a point.
    panel = devices.panels(published)[0]
    orders = [("direct", "low"), ("direct", "high")]
    bounds = [(0, None), (0, None)]
    most = linear_program(0, panel.wall, (10.0, 10.0), orders, bounds=bounds)
    assert most < asked / 3


@pytest.mark.parametrize("row", range(5))
def test_where_the_reference_lies_between_the_curves_by_a_dense_scan(row, published, claims):
    wall = published.walls[row]
    low, high, direct, coupled = four(RANGE, SCENE, wall)
    found = numbers_of(claims["reference-inside"])[f"share, {wall.name}"]
    assert found == pytest.approx(((low <= direct) & (direct <= high)).mean(), abs=2e-4)
    if row < 3:
        inside = numbers_of(claims["lower-or-medium"])[f"share with |Z_h_vc| inside, {wall.name}"]
        assert inside == pytest.approx(((low <= coupled) & (coupled <= high)).mean(), abs=2e-4)


def test_below_the_environment_by_a_dense_scan(published, claims):
    s, _ = parts(RANGE)
    for wall in published.walls:
        rendered = abs(wall.b + wall.k / s)
        below = felt(RANGE, SCENE, wall.k, wall.b, True) < rendered
        found = numbers_of(claims["always-smaller"])[f"share of the range, {wall.name}"]
        assert found == pytest.approx(below.mean(), abs=2e-4)
        assert (felt(RANGE, (0.0, 0.0), wall.k, wall.b, True) < rendered).all()


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


@pytest.mark.parametrize("panel", [0, 1, 2])
def test_readings_over_devices_one_by_one(panel, published):
    shown = devices.panels(published)[panel]
    masses, dampings = devices.MASSES[::10], devices.DAMPINGS[::12]
    found = devices.over_devices(published, shown, masses, dampings[:, None])
    window = np.linspace(*shown.window, 9)
    wanted = [
        [bool(READINGS[shown.name](*four(window, (m, b), shown.wall)).all()) for m in masses]
        for b in dampings
    ]
    assert found.tolist() == wanted


def test_panels_take_the_windows_of_the_scene(published):
    assert [(p.name, p.wall.name, p.window) for p in devices.panels(published)] == [
        ("7b", "VE1", (9.89, 10.11)),
        ("7d", "VE2", (9.9, 10.1)),
        ("7f", "VE4", (9.3, 10.6)),
    ]


@pytest.mark.parametrize("limit", [0.0123, 1.0, 7.77])
def test_largest_finds_the_limit(limit):
    found = devices.largest(lambda x: x <= limit, np.geomspace(0.01, 10.0, 20))
    assert found == pytest.approx(limit, rel=1e-11)
    assert found <= limit


def test_largest_at_the_ends():
    scale = np.geomspace(0.01, 10.0, 20)
    assert devices.largest(lambda x: x > 0, scale) == np.inf
    assert devices.largest(lambda x: x < 0, scale) is None


def test_next_users_have_the_limits_of_the_lognormal_prediction(published):
    (lower, upper), _ = published.next_user[1]
    mean, sd = 981.03, 35.200
    spread = np.sqrt(np.log1p((sd / mean) ** 2))
    centre = np.log(mean) - spread**2 / 2
    wanted = np.exp(centre + np.array([-1, 1]) * 3.40846 * spread)
    np.testing.assert_allclose([lower, upper], wanted, rtol=2e-4)


def test_fig_7f_is_true_of_any_device(published):
    panel = devices.panels(published)[2]
    rng = np.random.default_rng(1)
    omega = np.linspace(*panel.window, 101)[:, None]
    every = four(omega, (rng.uniform(0, 30, 500), rng.uniform(0, 50, 500)), panel.wall)
    assert READINGS["7f"](*every).all()


def test_the_change_passes_the_band_where_the_boundaries_cross_in_the_window(published, claims):
    panel = devices.panels(published)[0]
    fine = np.linspace(*panel.window, 4001)

    def passed(m, b_d):
        low, high, direct, coupled = four(fine, (m, b_d), panel.wall)
        return (abs(coupled - direct) > high - low).mean()

    def crossing(m, b_d, omega):
        low, high = (
            felt(omega, (m, b_d), k, b)
            for k, b in zip(panel.wall.stiffness, panel.wall.damping, strict=True)
        )
        return high - low

    found = numbers_of(claims["coupling-unnoticed"])
    part = found["share of the window with the change above the band, largest"]
    mass, damping = found["mass with the largest"], found["damping with the largest"]
    assert passed(mass, damping) == pytest.approx(part, abs=0.01)
    peaks = []
    for b_d in np.linspace(0.0, 50.0, 6):
        ends = [
            optimize.brentq(crossing, 0.05, 30.0, args=(b_d, omega), xtol=1e-12)
            for omega in panel.window
        ]
        peaks.append(max(passed(m, b_d) for m in np.linspace(*ends, 101)))
    assert peaks == sorted(peaks)
    assert part == pytest.approx(peaks[-1], abs=0.01)
    # Off the ridge the change stays below the band.
    low, high, direct, coupled = four(fine, SCENE, panel.wall)
    own = found["largest change over the band at the same ω, scene’s device"]
    assert own == pytest.approx((abs(coupled - direct) / (high - low)).max(), rel=1e-6)
    assert own < 1


def test_a_flexible_mass_by_newton_s_laws(published, claims):
    # 1 kg on a spring of 300² N/m, driven at the spring's end: F = k(x − y), mÿ = F in Tustin's s.
    s, zoh = parts(RANGE)
    k = 300.0**2
    driven = np.array(
        [[np.full(s.shape, k), np.full(s.shape, -k)], [np.full(s.shape, -k), k + s**2]]
    )
    moved = np.linalg.solve(np.moveaxis(driven, -1, 0), np.array([1.0, 0.0])[:, None])
    flexible = 1 / (s * moved[:, 0, 0]) + 5.0
    found = numbers_of(claims["resonance-ignored"])
    for wall, _ in published.drawn:
        ratio = abs(flexible + zoh * (wall.b + wall.k / s)) / felt(RANGE, SCENE, wall.k, wall.b)
        largest = np.maximum(ratio, 1 / ratio).max() - 1
        assert found[f"largest change, {wall.name}"] == pytest.approx(largest, rel=1e-4)


def test_realism_spoilt_by_the_coupling_by_a_dense_scan(published, claims):
    omega = RANGE[::5]
    s, _ = parts(omega)
    gain, half = np.cos(omega * T / 2), omega * T / 2
    rate, spoilt = s.imag, 0
    for wall, ((k_low, k_high), (b_low, b_high)) in zip(
        published.walls, published.next_user, strict=True
    ):
        for mass in (0.0, *devices.MASSES[::14]):
            # |Z_h| is a distance in (g·b, g·k/Ω): nearest point by clipping, farthest at a corner.
            turned = (1j * mass * rate + 5.0) * np.exp(1j * half)
            across, along = -turned.real / gain, turned.imag * rate / gain
            near = [
                np.clip(at, low, high) - at
                for at, low, high in ((across, b_low, b_high), (along, k_low, k_high))
            ]
            low = gain * np.hypot(near[0], near[1] / rate)
            high = gain * np.max(
                [
                    np.hypot(b - across, (k - along) / rate)
                    for b in (b_low, b_high)
                    for k in (k_low, k_high)
                ],
                axis=0,
            )
            direct, coupled = (
                felt(omega, (mass, 5.0), wall.k, wall.b, how) for how in (False, True)
            )
            kept, lost = ((low <= one) & (one <= high) for one in (direct, coupled))
            spoilt += kept.all() and not lost.all()
    assert claims["affects-realism"].margin.value == spoilt


def test_effective_stiffness_by_springs_in_series(published, claims):
    # At 10 rad/s dampers carry so little that the springs' own formula is good to five digits.
    found = numbers_of(claims["suits-high"])
    for wall in published.walls:
        series = wall.k * 50e3 / (wall.k + 50e3)
        assert found[f"effective stiffness, {wall.name}"] == pytest.approx(series, rel=1e-4)


def test_table_1_is_printed_again(published):
    printed = {
        (name, p): (str(low), str(high))
        for name, lows, highs in zip(
            published.limits.environments,
            published.limits.lower,
            published.limits.upper,
            strict=True,
        )
        for p, low, high in zip("kb", lows, highs, strict=True)
    }
    found = {(row[0], row[1]): (row[5], row[6]) for row in table.limits_printed(published)}
    assert found == printed


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


def everywhere(published, limits_of):
    """Limits of every cell, from its reference."""
    return {
        (wall.name, p, column): text
        for wall in published.walls
        for p, value in (("k", wall.k), ("b", wall.b))
        for column, text in zip(("lower", "upper"), limits_of(value), strict=True)
    }


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


def test_users_covered_follows_the_number_of_subjects(changed):
    shares = [judged("users-covered", changed(n=n)).numbers[0].value for n in (5, 10, 20, 30, 100)]
    assert shares == pytest.approx([0.8667, 0.6472, 0.4601, 0.3757, 0.2056], abs=5e-5)


def test_figure_7f_with_a_reference_inside(changed):
    assert judged("fig-7f", changed({("VE4", "k", "upper"): "25100"})).verdict == NOT


def test_figure_7d_with_limits_that_leave_the_coupled_stiffness_out(changed):
    assert judged("fig-7d", changed({("VE2", "k", "lower"): "990"})).verdict != ONLY_IF
    assert judged("fig-7d", changed({("VE2", "k", "lower"): "999"})).verdict == NOT


def test_realism_survives_if_no_reference_was_inside(published, changed):
    far = changed(everywhere(published, lambda x: (f"{5 * x:.6g}", f"{5.1 * x:.6g}")))
    assert judged("affects-realism", far).verdict == NOT
    assert judged("mass-left-out", far).verdict == NOT


def test_walls_in_order_throughout_if_they_are_stiff(changed):
    stiff = {}
    for name, k in (("VE1", 100e3), ("VE2", 200e3), ("VE4", 300e3)):
        for column, part in (("reference", 1.0), ("lower", 0.95), ("upper", 1.05)):
            stiff[name, "k", column] = f"{part * k:g}"
    assert judged("like-shapes", changed(stiff)).verdict == HOLDS
