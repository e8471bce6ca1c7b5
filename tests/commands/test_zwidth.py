import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from percept.cli import main
from percept.haptics import Coupling, Device, Environment, required_damping
from percept.haptics.loop import Hold
from percept.haptics.rendering import passivity_damping
from percept.study.device import Loop
from percept.study.device_draws import DeviceDraws
from percept.study.zwidth import z_width

T = 1e-3
DEVICE = "[device]\nmass = 1.0\ndamping = 5.0\nperiod = 0.001\n"


@pytest.fixture
def scene(tmp_path):
    def written(*lines):
        path = tmp_path / "scene.toml"
        path.write_text(DEVICE + "\n".join(lines), encoding="utf-8")
        return str(path)

    return written


def test_edges_are_printed_and_need_the_damping_of_the_device(scene, capsys):
    assert main(["zwidth", scene("delay = 1.0"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    direct = printed["direct"]
    walls = Environment(direct["stiffness"][:-1], direct["damping"][:-1])
    assert passivity_damping(walls, T, delay=1.0).colgate == pytest.approx(
        np.full(len(direct["stiffness"]) - 1, 5.0), rel=1e-8
    )
    coupled = printed["coupled"]
    couplings = Coupling(coupled["stiffness"][1:-2], coupled["damping"][1:-2])
    needed = required_damping(couplings, T, hold=Hold(delay=1.0)).damping
    assert needed == pytest.approx(np.full(len(needed), 5.0), rel=1e-8)
    for edge in (direct, coupled):
        stiffest = edge["stiffness"].index(max(edge["stiffness"]))
        assert edge["stiffest"] == edge["stiffness"][stiffest]
        assert edge["stiffest_damping"] == edge["damping"][stiffest]
        assert edge["most_damping"] == edge["damping"][-1]


def test_the_figure_is_written(scene, tmp_path, capsys):
    path = tmp_path / "zwidth.svg"
    assert main(["zwidth", scene("delay_seconds = 0.002"), "--out", str(path)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(path)
    words = " ".join(ET.parse(path).getroot().itertext())
    assert "a rigid wall through a coupling" in words
    assert "rendered directly" in words
    assert main(["zwidth", scene(), "--out", str(tmp_path / "none" / "a.svg")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_a_measured_device_has_no_direct_edge(tmp_path, capsys):
    omega = np.geomspace(0.01, 4000.0, 200)
    table = np.column_stack([omega, np.full(200, 8.0), omega])
    header = "omega,real,imaginary"
    np.savetxt(tmp_path / "zd.csv", table, delimiter=",", header=header, comments="")
    path = tmp_path / "scene.toml"
    path.write_text('[device]\nresponse = "zd.csv"\nperiod = 0.001\n', encoding="utf-8")
    assert main(["zwidth", str(path)]) == 0
    out = capsys.readouterr().out
    assert "(Colgate and Schenkel): the device's table does not tell." in out
    assert "Through a coupling, a rigid wall behind it (Llewellyn):\n" in out
    assert main(["zwidth", str(path), "--out", str(tmp_path / "a.svg")]) == 1
    assert "there is no figure of a device known by a table" in capsys.readouterr().err


def test_a_scene_without_a_device_is_refused(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text("[frequency]\nupper = 50.0\n", encoding="utf-8")
    assert main(["zwidth", str(path)]) == 2
    assert "there is no [device]" in capsys.readouterr().err


def test_a_device_without_damping_renders_nothing():
    width = z_width(Device(1.0, 0.0), T, Loop(Hold(delay=1.0), None), {})
    assert width.direct.stiffest == width.direct.most_damping == 0
    assert width.coupled.stiffest == width.coupled.most_damping == 0


def test_of_a_posterior_95_per_cent_of_devices_render_the_likely_edge():
    rng = np.random.default_rng(4)
    damping = np.exp(rng.normal(np.log(8.0), 0.2, 512))
    draws = DeviceDraws(Device(np.full(512, 1.0), damping))
    loop = Loop(Hold(delay=0.7), None)
    width = z_width(Device(1.0, 8.0), T, loop, {}, draws)
    inner = slice(3, -3, 25)
    likely = width.likely_direct
    walls = Environment(likely.stiffness[inner], likely.damping[inner])
    for needed in passivity_damping(walls, T, delay=0.7).colgate:
        assert np.mean(damping >= needed * (1 - 1e-9)) == pytest.approx(0.95, abs=0.002)
    likely = width.likely_coupled
    couplings = Coupling(likely.stiffness[inner], likely.damping[inner])
    for needed in required_damping(couplings, T, hold=Hold(delay=0.7)).damping:
        assert np.mean(damping >= needed * (1 - 1e-9)) == pytest.approx(0.95, abs=0.002)
    alone = z_width(Device(1.0, 8.0), T, loop, {})
    assert alone.likely_direct is alone.likely_coupled is None
