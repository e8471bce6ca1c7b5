import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from percept.cli import main
from percept.haptics import Coupling, Device, Environment, Loop, needed_damping
from percept.study.rendering import z_width

T = 1e-3
DEVICE = "[device]\nmass = 1.0\ndamping = 5.0\nperiod = 0.001\n"


@pytest.fixture
def scene(tmp_path):
    def written(*lines):
        path = tmp_path / "scene.toml"
        path.write_text(DEVICE + "\n".join(lines), encoding="utf-8")
        return str(path)

    return written


def test_the_edge_is_printed_and_needs_the_damping_of_the_device(scene, capsys):
    assert main(["zwidth", scene("delay = 1.0")]) == 0
    printed = [line.split() for line in capsys.readouterr().out.splitlines()[3:]]
    assert main(["zwidth", scene("delay = 1.0"), "--json"]) == 0
    edge = json.loads(capsys.readouterr().out)["edge"]
    pairs = {
        (f"{damping:.6g}", f"{stiffness:.6g}")
        for damping, stiffness in zip(edge["damping"], edge["stiffness"], strict=True)
    }
    assert len(printed) > 5
    assert set(map(tuple, printed)) <= pairs
    walls = Environment(edge["stiffness"], edge["damping"])
    needed = needed_damping(Loop(Device(1.0, 5.0), T, delay=1.0), walls).damping
    assert needed == pytest.approx(np.full(len(edge["stiffness"]), 5.0), rel=1e-8)
    # A coupling with a rigid wall behind it is a wall.
    couplings = Coupling(edge["stiffness"], edge["damping"])
    rigid = needed_damping(Loop(Device(1.0, 5.0), T, delay=1.0), None, coupling=couplings).damping
    assert rigid == pytest.approx(needed, rel=1e-12)
    stiffest = edge["stiffness"].index(max(edge["stiffness"]))
    assert edge["stiffest"] == edge["stiffness"][stiffest]
    assert edge["stiffest_damping"] == edge["damping"][stiffest]
    assert edge["most_damping"] == edge["damping"][-1]


def test_the_largest_stiffness_is_that_of_the_loop_in_time(tmp_path, capsys):
    """2b_d/T without delay and filter: 40,600 N/m at 20.3 N·s/m."""
    path = tmp_path / "scene.toml"
    path.write_text(DEVICE.replace("5.0", "20.3"), encoding="utf-8")
    assert main(["zwidth", str(path)]) == 0
    assert "up to 40600 N/m (beside 0 N·s/m), and up to 20.3 N·s/m." in capsys.readouterr().out


def test_the_figure_is_written(scene, tmp_path, capsys):
    path = tmp_path / "zwidth.svg"
    assert main(["zwidth", scene("delay_seconds = 0.002"), "--out", str(path)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(path)
    words = " ".join(ET.parse(path).getroot().itertext())
    assert "rendered with every hand" in words
    assert main(["zwidth", scene(), "--out", str(tmp_path / "none" / "a.svg")]) == 2
    assert "cannot be read or written" in capsys.readouterr().err


def test_a_measured_device_has_an_edge_where_its_floor_is_stated(tmp_path, capsys):
    omega = np.concatenate([[0.0], np.geomspace(0.01, 4000.0, 200)])
    table = np.column_stack([omega, np.full(201, 8.0), omega])
    header = "omega,real,imaginary"
    np.savetxt(tmp_path / "zd.csv", table, delimiter=",", header=header, comments="")
    path = tmp_path / "scene.toml"
    device = '[device]\nresponse = "zd.csv"\nperiod = 0.001\n[frequency]\nlower = 0.1\n'
    path.write_text(device, encoding="utf-8")
    assert main(["zwidth", str(path)]) == 0
    assert "no `response_floor` is stated" in capsys.readouterr().out
    assert main(["zwidth", str(path), "--out", str(tmp_path / "a.svg")]) == 1
    assert "the device's table does not tell what can be rendered" in capsys.readouterr().err
    floor = "period = 0.001\nresponse_floor = 8.0\n"
    path.write_text(device.replace("period = 0.001\n", floor), encoding="utf-8")
    assert main(["zwidth", str(path)]) == 0
    assert "up to 16000 N/m (beside 0 N·s/m), and up to 8 N·s/m." in capsys.readouterr().out


def test_a_scene_without_a_device_is_refused(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text("[frequency]\nupper = 50.0\n", encoding="utf-8")
    assert main(["zwidth", str(path)]) == 2
    assert "there is no [device]" in capsys.readouterr().err


def test_a_device_without_damping_renders_nothing():
    width = z_width(Loop(Device(1.0, 0.0), T, delay=1.0), {})
    assert width.edge.stiffest == width.edge.most_damping == 0


def test_of_a_posterior_95_per_cent_of_devices_render_the_likely_edge():
    rng = np.random.default_rng(4)
    damping = np.exp(rng.normal(np.log(8.0), 0.2, 512))
    draws = Device(np.full(512, 1.0), damping)
    loop = Loop(Device(1.0, 8.0), T, delay=0.7)
    width = z_width(loop, {}, draws)
    inner = slice(3, -3, 25)
    walls = Environment(width.likely.stiffness[inner], width.likely.damping[inner])
    for needed in needed_damping(loop, walls).damping:
        assert np.mean(damping >= needed * (1 - 1e-9)) == pytest.approx(0.95, abs=0.002)
    assert z_width(loop, {}).likely is None
