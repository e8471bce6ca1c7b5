"""The command: a log becomes a scene's device, a page and JSON."""

import json

import numpy as np
import pytest

from percept import Scene
from percept.cli import main
from percept.identify.model import Terms
from percept.study.device import device_of
from percept.study.device_draws import device_draws
from tests.identify.simulated import Recording, simulate

RECORDING = Recording(length=256, periods=6)


def log_file(tmp_path, terms, values):
    log = simulate(terms, values, np.random.default_rng(3), RECORDING)
    time = np.arange(log.force.size) * log.step
    rows = [
        f"{t!r},{f!r},{v!r}"
        for t, f, v in zip(*map(np.ndarray.tolist, (time, log.force, log.motion)), strict=True)
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,force,velocity", *rows]), encoding="utf-8")
    return str(path)


def test_a_log_becomes_the_device_of_a_scene(tmp_path, capsys):
    terms, values = Terms(1, delay=True), [1.0, 5.0, 2e-3, 0.2, 8e3, 2.0]
    out = tmp_path / "device.toml"
    words = ["identify", log_file(tmp_path, terms, values), "--repeat", "0.256", "--modes", "1"]
    assert main([*words, "--delay", "--json", "--out", str(out)]) == 0
    found = json.loads(capsys.readouterr().out)
    by_name = {estimate["name"]: estimate for estimate in found["estimates"]}
    device = Scene.load(out).device
    assert device.mass == by_name["mass"]["value"]
    assert device.modes[0].stiffness == by_name["mode 1 stiffness"]["value"]
    assert device.delay is None
    assert len(device.posterior.covariance) == 5
    for name, value in zip(by_name, values, strict=True):
        assert by_name[name]["lower"] < value < by_name[name]["upper"]
    assert "# delay of the log: 0.00" in out.read_text(encoding="utf-8")
    page = (tmp_path / "device.html").read_text(encoding="utf-8")
    assert "The device explains the log" in page
    assert "<svg" in page


def test_what_the_log_does_not_tell_is_no_number(tmp_path, capsys):
    out = tmp_path / "device.toml"
    log = log_file(tmp_path, Terms(), [1.0, 5.0])
    words = ["identify", log, "--repeat", "0.256", "--spring", "--out", str(out)]
    assert main(words) == 0
    assert "stiffness         not identifiable: 95 % of its posterior" in capsys.readouterr().out
    assert "# stiffness: not identifiable" in out.read_text(encoding="utf-8")
    assert "Not identifiable: stiffness" in out.with_suffix(".html").read_text(encoding="utf-8")


def test_the_scene_takes_a_spring_that_the_log_tells(tmp_path, capsys):
    out = tmp_path / "device.toml"
    values = [1.0, 5.0, 2000.0]
    log = log_file(tmp_path, Terms(spring=True), values)
    words = ["identify", log, "--repeat", "0.256", "--spring", "--out", str(out)]
    assert main([*words, "--quiet"]) == 0
    table = Scene.load(out).device
    assert table.posterior.parameters == ("mass", "damping", "stiffness")
    assert table.stiffness == pytest.approx(2000.0, rel=0.05)
    assert device_of(Scene.load(out)).stiffness == table.stiffness
    drawn = device_draws(Scene.load(out)).stacked.stiffness
    sd = np.sqrt(table.posterior.covariance[2][2])
    assert np.log(drawn).std() == pytest.approx(sd, rel=0.01)


def test_a_device_without_damping_is_refused_and_its_page_is_there(tmp_path, capsys):
    out = tmp_path / "device.toml"
    log = log_file(tmp_path, Terms(), [1.0, 1e-6])
    assert main(["identify", log, "--repeat", "0.256", "--out", str(out), "--quiet"]) == 1
    assert "The log does not tell the damping" in capsys.readouterr().err
    assert not out.exists()
    assert out.with_suffix(".html").exists()


def test_a_device_that_does_not_fit_is_told(tmp_path, capsys):
    out = tmp_path / "device.toml"
    log = log_file(tmp_path, Terms(modes=1), [1.0, 5.0, 0.2, 8e3, 2.0])
    assert main(["identify", log, "--repeat", "0.256", "--out", str(out)]) == 0
    assert "does not explain the log: its misfit" in capsys.readouterr().err
    assert "# The device does not explain the log" in out.read_text(encoding="utf-8")
    assert "does not explain the log" in out.with_suffix(".html").read_text(encoding="utf-8")


def test_a_response_needs_the_sampling_period(tmp_path, capsys):
    path = tmp_path / "zd.csv"
    path.write_text("omega,real,imaginary\n1,5,1\n2,5,2\n", encoding="utf-8")
    assert main(["identify", str(path), "--out", str(tmp_path / "device.toml")]) == 2
    assert "Give --period" in capsys.readouterr().err
