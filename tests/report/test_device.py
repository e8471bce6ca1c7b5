from __future__ import annotations

import copy

import numpy as np
import pytest

from percept import Study, haptics
from percept.report.design import design_of
from percept.report.select import array
from percept.report.sensitivity import device_sensitivity

PERIOD = 0.001


def box_of(document, environment, kind):
    """Limits of k and b, and the reference, straight from the intervals."""
    rows = {
        row["parameter"]: row
        for row in document["intervals"]
        if (row["environment"], row["kind"], row["family"], row["joint"], row["method"])
        == (environment, kind, "lognormal", "marginal", "classical")
    }
    k, b = rows["k"], rows["b"]
    limits = (k["lower"], k["upper"]), (b["lower"], b["upper"])
    return *limits, haptics.Environment(k["reference"], b["reference"])


def test_stability_turns_where_the_required_damping_lies(classical):
    found = classical["sensitivity"]
    # Derived for 50 kN/m and 100 N·s/m at 1 ms.
    assert found["required_damping"] == pytest.approx(15.8384, abs=5e-5)
    for damping, verdicts in zip(found["damping"], found["verdict"], strict=True):
        assert set(verdicts) == {"stable" if damping > found["required_damping"] else "unstable"}


@pytest.mark.parametrize(("i", "j"), [(0, 6), (3, 3), (6, 0)])
def test_counts_are_those_of_a_search_over_all_points_of_the_box(classical, i, j):
    found = classical["sensitivity"]
    device = haptics.Device(found["mass"][j], found["damping"][i])
    coupling = haptics.Coupling(50e3, 100.0)
    omega = array(classical["boundaries"][0]["omega"])
    inside = 0
    for environment in classical["data"]["environments"]:
        k, b, reference = box_of(classical, environment, "user")
        felt = abs(haptics.perceived_impedance(omega, device, reference, PERIOD, coupling=coupling))
        grid = haptics.Environment(np.linspace(*k, 60)[None, :, None], np.linspace(*b, 60)[None, None, :])
        seen = abs(haptics.perceived_impedance(omega[:, None, None], device, grid, PERIOD))
        # A grid sees less than the box holds; a felt impedance clearly outside is outside for both.
        slack = 0.02 * felt
        low, high = seen.min(axis=(1, 2)) - slack, seen.max(axis=(1, 2)) + slack
        inside += bool(((low <= felt) & (felt <= high)).all())
    assert found["inside"]["user"][i][j] == inside


def test_every_coupling_of_the_map_is_stable_and_inside(classical):
    (design,) = classical["design"]["maps"]
    device = haptics.Device(1.0, 5.0)
    omega = np.geomspace(0.1, 100, 41)
    checked = 0
    for one in design["environments"][:-1]:
        k, b, reference = box_of(classical, one["name"], "user")
        low, high = haptics.magnitude_envelope(omega, device, k, b, PERIOD)
        for place in ("largest", "softest"):
            if one[place] is None:
                continue
            coupling = haptics.Coupling(one[place]["stiffness"], one[place]["damping"])
            felt = abs(haptics.perceived_impedance(omega, device, reference, PERIOD, coupling=coupling))
            assert ((low * (1 - 1e-9) <= felt) & (felt <= high * (1 + 1e-9))).all()
            assert haptics.absolute_stability(device, coupling, PERIOD).verdict != "unstable"
            checked += 1
    assert checked >= 4


def test_no_coupling_qualifies_where_the_map_says_none(classical):
    (design,) = classical["design"]["maps"]
    device = haptics.Device(1.0, 5.0)
    omega = np.geomspace(0.1, 100, 41)
    barred = [one["name"] for one in design["environments"][:-1] if one["largest"] is None]
    assert barred
    for name in barred:
        k, b, reference = box_of(classical, name, "user")
        low, high = haptics.magnitude_envelope(omega, device, k, b, PERIOD)
        for damping in np.linspace(0, 40, 9):
            top = haptics.max_coupling_stiffness(5.0, damping, PERIOD)
            for stiffness in np.linspace(0.01, 1, 8) * top:
                coupling = haptics.Coupling(stiffness, damping)
                felt = abs(haptics.perceived_impedance(omega, device, reference, PERIOD, coupling=coupling))
                assert not ((low <= felt) & (felt <= high)).all()


def test_modes_count_and_a_measured_device_is_left_alone(classical):
    document = copy.deepcopy(classical)
    document["intervals"] = [row for row in document["intervals"] if row["environment"] == "VE1"]
    rigid = device_sensitivity(document)
    device = document["provenance"]["scene"]["device"]
    # A mode so light and stiff that it adds its mass and nothing else below 100 rad/s.
    device["modes"] = [{"mass": 1e-6, "stiffness": 1e4, "damping": 1.0}]
    assert device_sensitivity(document)["inside"] == rigid["inside"]
    document["provenance"]["scene"]["device"] = {"response": "zd.csv", "period": 0.001}
    assert device_sensitivity(document) is None


def test_without_a_coupling_the_reference_itself_is_judged(classical):
    document = copy.deepcopy(classical)
    del document["provenance"]["scene"]["coupling"]
    found = device_sensitivity(document)
    assert found["required_damping"] is None
    assert {verdict for row in found["verdict"] for verdict in row} == {None}
    boxes = [box_of(classical, environment, "user") for environment in classical["data"]["environments"]]
    held = sum(
        k[0] <= reference.stiffness <= k[1] and b[0] <= reference.damping <= b[1] for k, b, reference in boxes
    )
    # A reference inside its own box of k and b is inside at every ω, with any device; others may be.
    assert held == 4
    assert {count >= held for row in found["inside"]["user"] for count in row} == {True}


def test_the_map_has_an_edge_for_a_rigid_device_only(classical, classical_study):
    assert max(classical["design"]["stable"]["stiffness"]) == pytest.approx(5 / 0.10695 / PERIOD, rel=1e-4)
    tables = classical_study.scene.to_dict()
    tables["device"]["modes"] = [{"mass": 0.01, "stiffness": 1e4, "damping": 1.0}]
    tables["frequency"]["points"] = 5
    table = classical_study.sessions.table
    alone = type(classical_study.sessions).from_frame(table[table["environment"] == "VE1"])
    modal = Study(alone, type(classical_study.scene).from_tables(tables))
    assert design_of(modal)["stable"] is None
    assert [one["name"] for one in design_of(modal)["maps"][0]["environments"]][-1] is None
