"""What a coupling's verdicts stand for, and the populations that displays are held against."""

from __future__ import annotations

import numpy as np
import pytest

from percept import haptics
from percept.haptics import Loop
from percept.scene import FrequencyTable
from percept.study.device import Setup, study_coupling
from percept.study.rendering import study_rendering


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
