"""What a coupling's verdicts stand for, and the populations that displays are held against."""

from __future__ import annotations

import numpy as np
import pytest

from percept import Study, haptics
from percept.haptics import magnitude_envelope
from percept.study.device import Setup, study_coupling

RANGE = (0.1, 100.0)  # rad/s


@pytest.mark.parametrize("part", [0.999, 1.001])
def test_a_device_is_passive_from_colgate_s_damping(part: float) -> None:
    """b_d > k T/2 + b; the paper's own condition asks for less."""
    period, reference = 0.001, haptics.Environment(50e3, 50.0)
    needed = 0.5 * 50e3 * period + 50.0
    setup = Setup(
        haptics.Device(1.0, part * needed),
        period,
        "average",
        {"E": reference},
        haptics.Coupling(1e3, 1.0),
    )
    table = setup.passivity
    assert table["needed_colgate"].tolist() == pytest.approx([needed])
    assert table["needed_paper"].item() < needed
    assert table["passive"].tolist() == [part > 1.0]


def measured(last: float, damping: float) -> Setup:
    """A device of 1 kg as a table up to a part of the Nyquist frequency."""
    omega = np.geomspace(1e-3, last * np.pi / 1e-3, 400)
    impedance = haptics.device_impedance(omega, haptics.Device(1.0, damping), 1e-3)
    device = haptics.TabulatedDevice(omega, impedance)
    return Setup(device, 1e-3, "average", {}, haptics.Coupling(50e3, 100.0))


def test_a_measured_device_is_stable_with_a_word_on_its_poles() -> None:
    # 15.84 N·s/m are needed; a rigid device's poles are known, a table's are not.
    found = study_coupling(measured(0.9999, 16.0), [], RANGE, family="lognormal", read_at=10.0)
    assert found.verdict == "stable"
    assert found.reason.startswith(
        "The device is measured, so its poles cannot be checked. The smallest margin is 1.01"
    )
    for setup, verdict in ((measured(0.9999, 5.0), "unstable"), (measured(0.5, 16.0), "undecided")):
        without = study_coupling(setup, [], RANGE, family="lognormal", read_at=10.0)
        assert without.verdict == verdict
        assert "poles" not in without.reason


def test_verdicts_of_envelopes_are_those_of_a_fine_grid(fitted: Study) -> None:
    assert fitted.parts.setup is not None
    assert fitted.coupling is not None
    setup, omega = fitted.parts.setup, np.geomspace(0.1, 100.0, 20_000)
    regions = {r.environment: r for r in fitted.parts.regions if _of_user(r)}
    verdicts = set()
    for row in fitted.coupling.memberships:
        assert _of_user(regions[row.environment])
        limits = regions[row.environment].limits
        assert limits is not None
        lower, upper = magnitude_envelope(omega, setup.device, *limits, setup.period)
        for coupled, name in ((False, "uncoupled"), (True, "coupled")):
            shown = setup.curve(row.environment, omega, coupled=coupled)
            seen = float(np.maximum(shown / upper, lower / shown).max()) - 1.0
            assert getattr(row, f"departure_{name}") == pytest.approx(seen, rel=1e-3, abs=1e-6)
            assert getattr(row, f"verdict_{name}") == ("outside" if seen > 0 else "inside")
            verdicts.add(getattr(row, f"verdict_{name}"))
    assert verdicts == {"inside", "outside"}


def _of_user(one) -> bool:
    return (one.method, one.kind, one.family, one.joint) == (
        "bayesian",
        "user",
        "lognormal",
        "marginal",
    )
