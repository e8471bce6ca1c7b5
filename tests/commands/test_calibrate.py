"""`percept calibrate`: what it simulates, what it says of it, and what it refuses."""

from __future__ import annotations

import csv
import re

import pandas as pd
import pytest

from percept.cli import main
from tests import DATASETS

SESSIONS = str(DATASETS / "hbfd_sessions.csv")


@pytest.fixture
def few(tmp_path):
    """The published sessions of two environments."""
    table = pd.read_csv(SESSIONS, dtype={"subject": str}).drop(columns="source")
    path = tmp_path / "few.csv"
    table[table["environment"].isin(["VE2", "VE4"])].to_csv(path, index=False)
    return str(path)


def calibrate(tmp_path, *more, scene=""):
    (tmp_path / "scene.toml").write_text(scene)
    asked = [
        "--from",
        "prior",
        "--method",
        "classical",
        "--studies",
        "3",
        "--workers",
        "1",
        "--quiet",
    ]
    out = ["--out", str(tmp_path / "out"), "--scene", str(tmp_path / "scene.toml")]
    return main(["calibrate", *(more or (SESSIONS,)), *asked, *out])


def test_the_page_says_what_was_simulated(tmp_path, capsys, few):
    scene = (
        "[device]\nmass = 0.5\ndamping = 2.0\nperiod = 2e-3\n[inference]\nlevel = 0.9\nshare ="
        " 0.6\n"
    )
    assert calibrate(tmp_path, few, scene=scene) == 0
    page = (tmp_path / "out" / "coverage.md").read_text()
    assert capsys.readouterr().out.strip() == str(tmp_path / "out" / "coverage.md")
    said = " ".join(page.split())
    assert (
        "of few.csv, its subjects and trials, and the prior, refitted by the classical"
        " method." in said
    )
    assert (
        "a device of 0.5 kg and 2 N·s/m at a period of 0.002 s, at 11 frequencies from 0.1 to 100"
        " rad/s." in said
    )
    assert "`[model]`, modes and hold are not." in said
    with (tmp_path / "out" / "coverage.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["method"] for row in rows} == {"classical"}
    assert {
        float(row["stated"]) for row in rows if row["kind"] in ("mean", "user") and row["stated"]
    } >= {0.9}
    # What holds 60 % of users holds less than what holds 99 %.
    wide = tmp_path / "wide"
    wide.mkdir()
    assert calibrate(wide, few, scene="[inference]\nlevel = 0.9\nshare = 0.99\n") == 0
    assert (wide / "out" / "judged.jsonl").read_text() != (
        tmp_path / "out" / "judged.jsonl"
    ).read_text()


def test_a_study_of_another_quantity_has_no_curves(tmp_path):
    words = ["simulate", "--like", str(tmp_path / "table.csv"), "--out", str(tmp_path / "d.csv")]
    (tmp_path / "table.csv").write_text(
        "environment,parameter,reference,lower,upper,n,level\n"
        "short,duration,400,350,470,8,0.95\nlong,duration,900,700,880,8,0.95\n"
    )
    scene = '[quantities.duration]\nunit = "ms"\n[inference]\nseed = 2\n'
    (tmp_path / "words.toml").write_text(scene)
    assert main([*words, "--seed", "1", "--scene", str(tmp_path / "words.toml")]) == 0
    assert calibrate(tmp_path, str(tmp_path / "d.csv"), scene=scene) == 0
    page = (tmp_path / "out" / "coverage.md").read_text()
    assert "the classical method.\nOf the scene's other settings" in page
    assert not re.search(r"device|kg|boundar|N·s/m", page)
    with (tmp_path / "out" / "coverage.csv").open() as file:
        assert {row["claim"] for row in csv.DictReader(file)} == {"interval"}


def test_more_than_two_quantities_are_not_simulated_together(tmp_path, capsys):
    table = ["subject,environment," + ",".join(f"{q}_{of}" for q in "xyz" for of in ("ref", "adj"))]
    table += [f"{s},{e},1,1.{s},2,2.{s},3,3.{s}" for s in (1, 2, 3) for e in "ab"]
    (tmp_path / "three.csv").write_text("\n".join(table))
    scene = "".join(f'[quantities.{q}]\nunit = "mm"\n' for q in "xyz")
    assert calibrate(tmp_path, str(tmp_path / "three.csv"), scene=scene) == 1
    error = capsys.readouterr().err
    assert "calibration simulates one quantity or two together" in error
    assert "[inference] parameters" in error


def test_each_method_has_its_own_number_of_studies_and_a_second_run_none(tmp_path, few):
    scene = tmp_path / "scene.toml"
    scene.write_text('[inference]\ntolerance = 0.3\nparameters = ["k"]\n')
    out = tmp_path / "out"
    words = ["calibrate", few, "--scene", str(scene), "--out", str(out), "--workers", "1"]
    words.append("--quiet")
    assert main([*words, "--studies", "2", "--classical", "3"]) == 0
    with (out / "coverage.csv").open() as file:
        counts = {(row["method"], row["studies"]) for row in csv.DictReader(file)}
    assert counts == {("classical", "3"), ("bayesian", "2")}
    judged = (out / "judged.jsonl").read_bytes()
    assert main([*words, "--studies", "2", "--classical", "3"]) == 0
    assert (out / "judged.jsonl").read_bytes() == judged


def test_what_cannot_be_simulated_is_refused_first(tmp_path, capsys):
    table = pd.read_csv(SESSIONS)
    table.loc[table["environment"] == "VE1", "k_ref"] = 0.0
    table.to_csv(tmp_path / "zero.csv", index=False)
    scene = '[inference]\nfamily = "normal"\n[model]\nscale = { k = 10.0 }\n'
    assert calibrate(tmp_path, str(tmp_path / "zero.csv"), scene=scene) == 1
    message = "the reference stiffness of VE1 is 0, and simulated responses are ratios to it"
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_published_limits_are_calibrated_with_as_many_subjects_as_are_asked_for(tmp_path, capsys):
    limits = str(DATASETS.parent / "reports" / "coverage" / "curves" / "references.csv")
    assert calibrate(tmp_path, limits, "--subjects", "4") == 0
    with (tmp_path / "out" / "coverage.csv").open() as file:
        assert {row["subjects"] for row in csv.DictReader(file)} == {"4"}
    assert calibrate(tmp_path, limits) == 2
    assert "a coverage study needs at least two subjects." in capsys.readouterr().err
