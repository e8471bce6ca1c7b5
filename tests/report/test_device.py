from __future__ import annotations

import numpy as np
import pytest

from percept import Study, haptics
from percept.report.design import design_of

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
