"""No verdict is written down: another table, another verdict."""

import numpy as np
import pytest

from percept.reproduce import devices
from percept.reproduce.claims import coupling, curves, figures, limits, stability, text

HOLDS, ONLY_IF, NOT = "holds", "holds only if", "does not hold"


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
    assert limits.reference_inside(wide).verdict == HOLDS
    assert limits.normal_values(wide).verdict == HOLDS
    shifted = changed(everywhere(published, lambda x: (f"{1.1 * x:.6g}", f"{1.2 * x:.6g}")))
    assert limits.reference_inside(shifted).verdict == NOT


def test_a_misprinted_limit_is_no_t_interval(changed):
    # More digits than a double has cannot come back.
    odd = changed({("VE1", "k", "lower"): "10.80800000000000000001"})
    assert limits.reprinted(odd).verdict == ONLY_IF


def test_users_covered_follows_the_number_of_subjects(changed):
    shares = [limits.users_covered(changed(n=n)).numbers[0].value for n in (5, 10, 20, 30, 100)]
    assert shares == pytest.approx([0.8667, 0.6472, 0.4601, 0.3757, 0.2056], abs=5e-5)


def test_thirty_subjects_depends_on_what_was_done(changed):
    assert limits.thirty_subjects(changed(n=30)).verdict == ONLY_IF


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
    assert curves.discrimination(changed(cells)).verdict == HOLDS


def test_magnitude_is_enough_where_both_parameters_are_inside(changed):
    wide = {("VE2", "b", "lower"): "0.5"}
    assert curves.magnitude_suffices(changed(wide)).verdict == HOLDS


def test_text_and_table_agree_once_the_table_repeats_the_text(changed):
    repeated = {("VE2", "k", "reference"): "10", ("VE2", "b", "reference"): "0.1"}
    assert text.environments_in_text(changed(repeated)).verdict == HOLDS


def test_soft_walls_are_passive_without_a_coupling(published, changed):
    soft = {(wall.name, "k", "reference"): "100" for wall in published.walls}
    soft |= {(wall.name, "b", "reference"): "0.1" for wall in published.walls}
    assert stability.direct_rendering(changed(soft)).verdict == HOLDS


def test_realism_survives_if_no_reference_was_inside(published, changed):
    far = changed(everywhere(published, lambda x: (f"{5 * x:.6g}", f"{5.1 * x:.6g}")))
    assert coupling.affects_realism(far).verdict == NOT
