"""What a coupling's verdicts stand for, and the populations that displays are held against."""

from __future__ import annotations

import numpy as np
import pytest

from percept import Study, haptics
from percept.haptics import Loop, magnitude_envelope
from percept.scene import FrequencyTable
from percept.study.device import Setup, study_coupling
from percept.study.rendering import study_rendering

RANGE = (0.1, 100.0)  # rad/s


@pytest.mark.parametrize("part", [0.999, 1.001])
def test_displays_are_judged_in_time_directly_and_through_the_coupling(part: float) -> None:
    """b_d > A_e directly, A_cA_e/(A_c + A_e) through the coupling, A_c with a rigid wall."""
    period, reference = 0.001, haptics.Environment(50e3, 50.0)
    coupling = haptics.Coupling(1e5, 25.0)
    device = haptics.Device(1.0, part * 37.5)
    setup = Setup(haptics.Loop(device, period), {"E": reference}, coupling)
    direct, coupled, rigid = study_rendering(setup)
    assert (direct.environment, direct.coupled, direct.needed_damping) == ("E", False, 75.0)
    assert (coupled.environment, coupled.coupled, coupled.needed_damping) == ("E", True, 37.5)
    assert (rigid.environment, rigid.coupled, rigid.needed_damping) == (None, True, 75.0)
    assert (direct.verdict, rigid.verdict) == ("cannot", "cannot")
    assert coupled.verdict == ("can" if part > 1.0 else "cannot")
    assert coupled.stable == (part > 1.0)
    assert coupled.margin == pytest.approx(part)


def measured(last: float, damping: float) -> Setup:
    """A device of 1 kg as a table up to a part of the Nyquist frequency."""
    omega = np.geomspace(1e-3, last * np.pi / 1e-3, 400)
    impedance = haptics.device_impedance(Loop(haptics.Device(1.0, damping), 1e-3), omega)
    device = haptics.TabulatedDevice(omega, impedance)
    return Setup(haptics.Loop(device, 1e-3), {}, haptics.Coupling(50e3, 100.0))


def test_eq_10_is_undecided_beyond_a_measured_device_s_table() -> None:
    # 15.84 N·s/m are asked for.
    for setup, said in (
        (measured(0.9999, 16.0), "met"),
        (measured(0.9999, 5.0), "not met"),
        (measured(0.5, 16.0), "undecided"),
    ):
        found = study_coupling(setup, [], "lognormal", FrequencyTable())
        assert found.eq10 == said


def test_verdicts_of_envelopes_are_those_of_a_fine_grid(fitted: Study) -> None:
    assert fitted.setup is not None
    assert fitted.coupling is not None
    setup, omega = fitted.setup, np.geomspace(0.1, 100.0, 20_000)
    regions = {r.environment: r for r in fitted.regions if _of_user(r)}
    verdicts = set()
    for row in fitted.coupling.memberships:
        assert _of_user(regions[row.environment])
        limits = regions[row.environment].limits
        assert limits is not None
        lower, upper = magnitude_envelope(setup.loop, omega, *limits)
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
