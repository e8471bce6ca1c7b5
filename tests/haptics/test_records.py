"""Records refuse what no device, environment or coupling can be, and say so."""

import numpy as np
import pytest

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Loop,
    Mode,
    TabulatedDevice,
    device_impedance,
    magnitude_envelope,
)
from percept.haptics.perceived import perceived_magnitude


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Device(mass=-1.0, damping=5.0),
            r"value -1\.0: Device mass must not be negative\. Give it in kg",
        ),
        (
            lambda: Environment(stiffness=[1.0, -2.0], damping=0.0),
            r"value -2\.0: Environment stiffness",
        ),
        (
            lambda: Coupling(stiffness=np.nan, damping=0.5),
            r"value nan: Coupling stiffness must be finite",
        ),
        (
            lambda: Device(mass=np.inf, damping=0.5),
            r"Device mass must be finite and at most 1e\+100 kg",
        ),
        (
            lambda: Environment(stiffness="1000", damping=1.0),
            r"Environment stiffness must be real numbers in N/m",
        ),
        (
            lambda: Environment(stiffness=True, damping=1.0),
            r"must be real numbers in N/m, not bool",
        ),
        (
            lambda: Mode(mass=1.0, stiffness=-3.0, damping=0.0),
            r"Mode stiffness must not be negative",
        ),
        (lambda: Device(1.0, 5.0, modes=[(1, 2, 3)]), r"Device modes must be Mode records"),
    ],
)
def test_records_refuse(make, message):
    with pytest.raises(UsageError, match=message):
        make()


@pytest.mark.parametrize(
    ("omega", "impedance", "message"),
    [
        ([1.0], [1.0], "two or more"),
        ([1.0, 2.0], [1.0], "equal length"),
        ([1.0, 1.0], [1.0, 2.0], r"value 1\.0: TabulatedDevice omega must increase"),
        ([1.0, 2.0], [1.0, np.nan], "impedance must be finite"),
        ([1.0, 2.0], ["a", "b"], "impedance must be complex numbers"),
        ([1.0, 2.0], [[1.0, 2.0], [3.0]], "impedance has rows of unequal length"),
        ([1.0, 2.0], np.ma.masked_array([1.0, 2.0], mask=[0, 1]), "impedance has masked elements"),
        ([-1.0, 2.0], [1.0, 2.0], "TabulatedDevice omega must not be negative"),
    ],
)
def test_tables_refuse(omega, impedance, message):
    with pytest.raises(UsageError, match=message):
        TabulatedDevice(omega, impedance)


def test_table_is_linear_between_rows_and_conjugate_for_negative_omega():
    table = TabulatedDevice([10.0, 20.0], [2 + 4j, 4 + 10j])
    np.testing.assert_allclose(device_impedance(Loop(table, 1e-3), [15.0, -15.0]), [3 + 7j, 3 - 7j])


@pytest.mark.parametrize("omega", [9.99, 20.01, -25.0, 0.0])
def test_table_is_never_extrapolated(omega):
    table = TabulatedDevice([10.0, 20.0], [2 + 4j, 4 + 10j])
    with pytest.raises(UsageError, match=r"covers 10 to 20 rad/s only.*nothing is extrapolated"):
        perceived_magnitude(Loop(table, 1e-3), omega, 100.0, 1.0)


def test_records_keep_their_own_copies():
    stiffness = np.array([1.0, 2.0])
    environment = Environment(stiffness, 0.0)
    stiffness[0] = 99.0
    assert environment.stiffness[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        environment.stiffness[0] = 3.0
    impedance = np.ones(2, dtype=complex)
    table = TabulatedDevice([1.0, 2.0], impedance)
    impedance[0] = 7.0
    assert device_impedance(Loop(table, 1e-3), 1.0) == 1.0


def test_limits_may_be_negative_but_not_reversed():
    magnitude_envelope(Loop(Device(1, 5), 1e-3), 1.0, (-10.0, 5.0), (-1.0, 1.0))
    with pytest.raises(UsageError, match="lower limit of stiffness is above its upper"):
        magnitude_envelope(Loop(Device(1, 5), 1e-3), 1.0, (5.0, -10.0), (-1.0, 1.0))
    with pytest.raises(UsageError, match=r"limits of damping must be a pair"):
        magnitude_envelope(Loop(Device(1, 5), 1e-3), 1.0, (-10.0, 5.0), 1.0)
