"""Logs and responses as they are written, and what is wrong with those that are refused."""

import numpy as np
import pytest

from percept.errors import UsageError
from percept.identify.log import QUANTITIES, Response, read_log
from percept.identify.spectra import TimeLog


def written(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_log_in_time_with_units(tmp_path):
    text = "# a comment\nTime [ms];Force (N);Position (mm);temperature\n0;1;2;x\n1;2;3;y\n2;3;4;z\n"
    log = read_log(written(tmp_path, text))
    assert isinstance(log, TimeLog)
    assert log.step == pytest.approx(1e-3)
    assert log.is_position
    assert log.motion.tolist() == pytest.approx([2e-3, 3e-3, 4e-3])


def test_magnitude_and_phase_of_an_analyser(tmp_path):
    text = "Frequency (Hz),Magnitude (dB),Phase (deg),Coherence\n1,20,90,0.9\n2,0,-45,0.99\n"
    response = read_log(written(tmp_path, text))
    assert isinstance(response, Response)
    assert response.omega == pytest.approx(2 * np.pi * np.array([1.0, 2.0]))
    assert response.impedance == pytest.approx([10j, np.exp(-0.25j * np.pi)])
    assert response.coherence == pytest.approx([0.9, 0.99])


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_every_quantity_becomes_an_impedance(tmp_path, quantity):
    omega = np.array([3.0, 7.0])
    impedance = 2j * omega + 5.0 + 11.0 / (1j * omega)
    motion = {"stiffness": 1j * omega, "mass": 1.0 / (1j * omega)}
    value = {
        "impedance": impedance,
        "mobility": 1.0 / impedance,
        "dynamic stiffness": impedance * motion["stiffness"],
        "receptance": 1.0 / (impedance * motion["stiffness"]),
        "apparent mass": impedance * motion["mass"],
        "accelerance": 1.0 / (impedance * motion["mass"]),
    }[quantity]
    lines = [f"{w!r},{z.real!r},{z.imag!r}" for w, z in zip(omega.tolist(), value, strict=True)]
    text = "\n".join(["omega,real,imaginary", *lines]).replace("np.float64(", "").replace(")", "")
    response = read_log(written(tmp_path, text), quantity)
    assert response.impedance == pytest.approx(impedance, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,force\n0,1\n1,2\n", "There is no column 'position'; there are time, force"),
        ("time,force,velocity\n0,1,1\n1,x,1\n", "log.csv:3, column 'force', value 'x': must be a"),
        ("time,force,velocity\n0,1,1\n1,1,1\n3,1,1\n", "does not lie one step of 1.5 s"),
        ("time,force,velocity\n0,1,1\n", "fewer than two rows"),
        ("time (h),force,velocity\n0,1,1\n", "does not know the unit 'h'. It knows s, ms"),
        ("omega,real\n1,1\n", "There is no column 'imaginary'"),
        ("omega,real,imaginary\n2,1,1\n1,1,1\n", "must rise from above zero"),
        ("omega,real,imaginary\n1,0,0\n2,1,1\n", "The response is zero here"),
        ("real,imaginary\n1,1\n", "There is no column 'frequency'"),
    ],
)
def test_what_is_refused(tmp_path, text, message):
    with pytest.raises(UsageError) as error:
        read_log(written(tmp_path, text))
    assert message in str(error.value)


def test_a_file_that_is_not_there():
    with pytest.raises(UsageError, match="cannot be read"):
        read_log("nowhere.csv")
