"""The device: measured responses."""

from __future__ import annotations

import numpy as np
import pytest

from percept import Scene
from percept.errors import UsageError
from percept.sessions.options import FileLimits
from percept.study.device import device_of, read_response


def write(tmp_path, *rows):
    path = tmp_path / "zd.csv"
    path.write_text("omega,real,imaginary\n" + "\n".join(rows) + "\n")
    return str(path)


def test_values_are_those_of_the_file(tmp_path):
    device = read_response(write(tmp_path, "0.1,5,-2e3", "1,5.25,1", "10,6,10"), FileLimits())
    np.testing.assert_array_equal(device.omega, [0.1, 1.0, 10.0])
    np.testing.assert_array_equal(device.impedance, [5 - 2e3j, 5.25 + 1j, 6 + 10j])


@pytest.mark.parametrize("bad", ["1,5,inf", "1,-inf,2", "1,5,nan", "1,5,"])
def test_what_is_not_finite_is_refused_with_the_file(tmp_path, bad):
    path = write(tmp_path, "0.1,5,1", bad, "10,6,10")
    with pytest.raises(UsageError, match="finite") as caught:
        read_response(path, FileLimits())
    assert caught.value.file == path


def test_text_in_a_number_is_refused_with_the_file(tmp_path):
    path = write(tmp_path, "0.1,5,1", "1,five,2")
    with pytest.raises(UsageError, match=r"cannot be read: .*five") as caught:
        read_response(path, FileLimits())
    assert caught.value.file == path


def test_a_missing_column_is_named(tmp_path):
    path = tmp_path / "zd.csv"
    path.write_text("omega,real\n1,2\n")
    with pytest.raises(UsageError, match="There is no column 'imaginary'; there are omega, real"):
        read_response(str(path), FileLimits())


def scene_with(tmp_path, response, frequency=""):
    path = tmp_path / "scenes" / "scene.toml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'[device]\nresponse = "{response}"\nperiod = 0.001\n[frequency]\n{frequency}')
    return Scene.load(path)


def test_its_path_starts_from_the_scene_s_folder(tmp_path, monkeypatch):
    write(tmp_path, "0.1,5,1", "100,6,10")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    scene = scene_with(tmp_path, "../zd.csv")
    for one in (scene, scene.with_inference(level=0.9), scene.with_tables(checks={})):
        assert device_of(one).impedance[0] == 5 + 1j
    assert scene.to_dict()["device"]["response"] == "../zd.csv"
    assert device_of(scene_with(tmp_path, tmp_path / "zd.csv")).impedance[0] == 5 + 1j
    # Nothing is looked for where the command happens to run.
    write(elsewhere, "0.1,7,1", "100,7,10")
    with pytest.raises(UsageError, match="cannot be read") as caught:
        device_of(scene_with(tmp_path, "zd.csv"))
    assert caught.value.file == str(tmp_path / "scenes" / "zd.csv")


@pytest.mark.parametrize(("end", "value"), [("lower", 0.05), ("upper", 200.0)])
def test_a_table_that_does_not_cover_the_scene_is_refused(tmp_path, end, value):
    write(tmp_path, "0.1,5,1", "100,6,10")
    with pytest.raises(
        UsageError, match=r"covers 0.1 to 100 rad/s only.*narrow \[frequency\]"
    ) as caught:
        device_of(scene_with(tmp_path, "../zd.csv", f"{end} = {value}\n"))
    assert (caught.value.key, caught.value.value) == (f"frequency.{end}", value)
