import json

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study, read_sessions
from percept.cli import main
from percept.study.pairs import compare_studies

SESSIONS = "datasets/hbfd_sessions.csv"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two environments: all subjects with a group, and a scene that keeps it; the groups by themselves."""
    out = tmp_path_factory.mktemp("compare")
    table = pd.read_csv(SESSIONS, dtype={"subject": str}).drop(columns="source")
    table = table[table["environment"].isin(["VE2", "VE4"])]
    hand = np.where(table["subject"].isin(["S01", "S02", "S03", "S04", "S05"]), "left", "right")
    table.assign(hand=hand).to_csv(out / "all.csv", index=False)
    for name in ("left", "right"):
        table[hand == name].to_csv(out / f"{name}.csv", index=False)
    third = np.where(table["subject"] == "S01", "both", hand)
    table.assign(hand=third).to_csv(out / "three.csv", index=False)
    device = "[device]\nmass = 1.0\ndamping = 5.0\nperiod = 0.001\n[frequency]\npoints = 5\n"
    (out / "scene.toml").write_text(f'{device}[sessions]\ngroups = ["hand"]\n')
    (out / "hasty.toml").write_text("[inference]\ntolerance = 1e-4\nmost_steps = 200\n")
    (out / "light.toml").write_text(device.replace("mass = 1.0", "mass = 0.1"))
    return out


def printed(words, capsys):
    assert main([*map(str, words), "--quiet"]) == 0
    return capsys.readouterr().out


def test_groups_are_compared_as_files_of_their_own(folder, capsys):
    scene = ["--scene", folder / "scene.toml", "--method", "classical"]
    groups = json.loads(printed(["compare", folder / "all.csv", *scene, "--by", "hand", "--json"], capsys))
    plain = [*scene[2:], "--scene", folder / "light.toml"]
    files = [folder / "left.csv", folder / "right.csv"]
    apart = json.loads(printed(["compare", *files, *plain, "--json"], capsys))
    assert groups["studies"] == {"a": "hand left", "b": "hand right"}
    assert groups["differences"] == apart["differences"]
    assert groups["intervals"] == apart["intervals"]
    scene_alone = Scene().with_inference(method="classical")
    found = compare_studies(*(Study(read_sessions(path), scene_alone) for path in files))
    assert [row["value"] for row in apart["differences"]] == found.differences["value"].tolist()


def test_two_devices_differ_in_curves_only(folder, capsys):
    words = ["compare", folder / "all.csv", "--scene", folder / "scene.toml", "--method", "classical"]
    words += ["--other-scene", folder / "light.toml"]
    found = json.loads(printed([*words, "--json"], capsys))
    assert {row["width_ratio"] for row in found["intervals"]} == {1.0}
    assert {row["value"] for row in found["differences"]} == {1.0}
    assert max(row["area_upper"] for row in found["curves"]) > 0.01
    text = printed(words, capsys)
    assert f"B: {folder / 'all.csv'} under {folder / 'light.toml'}" in text
    assert f"The 10 of {len(found['curves'])} boundaries farthest apart" in text
    areas = [max(row["area_lower"], row["area_upper"]) for row in found["curves"]]
    assert f"{max(areas):.4g}" in text


def test_methods_are_printed_with_their_reasons(folder, capsys):
    words = ["compare", folder / "all.csv", "--scene", folder / "scene.toml", "--tolerance", "0.2"]
    found = json.loads(printed([*words, "--json"], capsys))
    assert len(found["comparison"]) == 2 * 2 * 3
    assert found["curves"]
    text = printed(words, capsys)
    assert text.startswith("Intervals in pairs, lognormal family:")
    for row in found["comparison"]:
        assert f"{row['spread_ratio']:.4g}" in text.split("Why they differ")[1]
    assert max(len(line) for line in text.splitlines()) < 160


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["three.csv", "--scene", "scene.toml", "--by", "hand"], 2, "3 groups, both, left, right"),
        (["all.csv", "--scene", "scene.toml", "--by", "foot"], 2, "there is no such column"),
        (["all.csv", "--by", "hand", "--other-scene", "light.toml"], 2, "leave --other-scene out"),
        (["all.csv", "left.csv", "right.csv"], 2, "one or two studies"),
        (["all.csv", "--method", "classical"], 1, "only the classical method was asked for"),
        (["all.csv", "--scene", "hasty.toml"], 1, "withheld, and the others stand alone. "),
    ],
)
def test_refused(folder, monkeypatch, capsys, words, code, message):
    monkeypatch.chdir(folder)
    assert main(["compare", *words, "--quiet"]) == code
    assert message in capsys.readouterr().err
