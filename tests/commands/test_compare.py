import json

import numpy as np
import pandas as pd
import pytest

from percept.cli import main
from tests import DATASETS
from tests.study.within import frame, study
from tests.unmixed import unmixed_sessions

SESSIONS = str(DATASETS / "hbfd_sessions.csv")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two environments: all subjects with a group, and a scene; the groups by themselves."""
    out = tmp_path_factory.mktemp("compare")
    table = pd.read_csv(SESSIONS, dtype={"subject": str}).drop(columns="source")
    table = table[table["environment"].isin(["VE2", "VE4"])]
    hand = np.where(table["subject"].isin(["S01", "S02", "S03", "S04", "S05"]), "left", "right")
    table.assign(hand=hand).to_csv(out / "all.csv", index=False)
    for name in ("left", "right"):
        table[hand == name].to_csv(out / f"{name}.csv", index=False)
    device = "[device]\nmass = 1.0\ndamping = 5.0\nperiod = 0.001\n[frequency]\npoints = 5\n"
    (out / "scene.toml").write_text(device)
    (out / "hasty.toml").write_text("[inference]\ntolerance = 0.01\nmost_steps = 200\n")
    unmixed_sessions().to_csv(out / "unmixed.csv", index=False)
    (out / "light.toml").write_text(device.replace("mass = 1.0", "mass = 0.1"))
    table.assign(hand=np.where(table["environment"] == "VE2", "left", "right")).to_csv(
        out / "within.csv", index=False
    )
    table.assign(k_adj=1.1 * table["k_adj"]).to_csv(out / "elsewhere.csv", index=False)
    (out / "first.toml").write_text(
        '[sessions]\nonly = { subject = ["S01", "S02", "S03", "S04"] }\n'
    )
    (out / "last.toml").write_text(
        '[sessions]\nonly = { subject = ["S04", "S05", "S06", "S07"] }\n'
    )
    (out / "others.toml").write_text(
        '[sessions]\nonly = { subject = ["S05", "S06", "S07", "S08"] }\n'
    )
    (out / "normal.toml").write_text("[inference]\nshare = 0.9\n")
    return out


def printed(words, capsys):
    assert main([*map(str, words), "--quiet"]) == 0
    return capsys.readouterr().out


def test_groups_of_a_file_differ_as_files_of_their_own_do(folder, capsys):
    words = ["--scene", folder / "scene.toml", "--method", "classical", "--json"]
    groups = json.loads(printed(["compare", folder / "all.csv", *words, "--by", "hand"], capsys))
    assert (groups["factor"], groups["levels"]) == ("hand", ["left", "right"])
    biases = {
        (row["parameter"], row["environment"]): row
        for row in groups["contrast"]
        if (row["of"], row["kind"]) == ("bias", "mean")
    }
    files = [folder / "left.csv", folder / "right.csv"]
    apart = json.loads(printed(["compare", *files, *words], capsys))
    found = [row for row in apart["differences"] if row["of"] == "bias"]
    assert len(found) == 4
    for row in found:
        bias = biases[row["parameter"], row["environment"]]
        for name in ("lower", "estimate", "upper", "p_value", "n"):
            assert row[name] == pytest.approx(bias[name], rel=1e-9)


def test_two_devices_differ_in_curves_only(folder, capsys):
    words = [
        "compare",
        folder / "all.csv",
        "--scene",
        folder / "scene.toml",
        "--method",
        "classical",
    ]
    words += ["--other-scene", folder / "light.toml"]
    found = json.loads(printed([*words, "--json"], capsys))
    assert {row["width_ratio"] for row in found["intervals"]} == {1.0}
    assert found["differences"] == []
    assert found["notes"][0].startswith("A and B are the same sessions: the table of their users")
    places = [abs(row["place"]) for row in found["curves"]]
    assert max(places) > 0.01
    text = printed(words, capsys)
    assert f"B: {folder / 'all.csv'} under {folder / 'light.toml'}" in text
    assert "The 6 of 6 boundaries farthest apart" in text
    assert f"{max(places):.4g}" in text
    assert found["notes"][0] in text
    assert "Bias, B against A" not in text


def test_the_same_sessions_under_two_settings_stand_side_by_side(folder, capsys):
    words = [
        "compare",
        folder / "all.csv",
        "--other-scene",
        folder / "normal.toml",
        "--method",
        "classical",
    ]
    text = printed(words, capsys)
    assert "Bias, B against A" not in text
    assert "width_ratio" in text.split("Intervals of A and B")[1]


def test_different_people_of_one_file_are_two_samples(folder, capsys):
    words = ["compare", folder / "all.csv", "--scene", folder / "first.toml"]
    words += ["--other-scene", folder / "others.toml", "--method", "classical", "--json"]
    found = json.loads(printed(words, capsys))
    assert found["notes"] == []
    assert len(found["differences"]) == 8


def test_conditions_of_the_same_subjects_are_paired(tmp_path, capsys):
    frame().to_csv(tmp_path / "hand.csv", index=False)
    words = [
        "compare",
        tmp_path / "hand.csv",
        "--by",
        "hand",
        "--method",
        "classical",
        "--level",
        "0.95",
    ]
    found = json.loads(printed([*words, "--json"], capsys))
    assert (found["factor"], found["levels"]) == ("hand", ["left", "right"])
    made = study(frame()).contrasts
    assert [row["lower"] for row in found["contrast"]] == made["lower"].tolist()
    text = printed(words, capsys)
    assert "Bias, right against left, ratio:" in text
    bias = made[(made["of"] == "bias") & (made["kind"] == "mean")]
    overall = bias[bias["environment"].isna()].iloc[0]
    own = text.partition("Bias, right against left, ratio:")[2]
    line = next(line for line in own.splitlines() if "overall" in line and "mean" in line)
    assert f"{overall['lower']:.4g}" in line
    assert "Spread, right against left, ratio of SDs between users:" in text
    zero = frame().assign(k_adj=0.0)
    zero.to_csv(tmp_path / "zero.csv", index=False)
    words[1] = tmp_path / "zero.csv"
    assert main([*map(str, words), "--quiet"]) == 1
    assert "no contrast can be worked out" in capsys.readouterr().err


@pytest.mark.evidence
def test_methods_are_printed_with_their_reasons(folder, capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("PERCEPT_CACHE", str(tmp_path))
    words = ["compare", folder / "all.csv", "--scene", folder / "scene.toml", "--tolerance", "0.2"]
    found = json.loads(printed([*words, "--json"], capsys))
    assert len(found["comparison"]) == 2 * 2 * 3
    kept = set(tmp_path.iterdir())
    text = printed(words, capsys)
    # The study's own posterior, each environment's, and one of the normal family: no other was
    # sampled.
    assert len(kept) == len(set(tmp_path.iterdir())) == 4
    assert text.startswith("\nIntervals in pairs, lognormal family, level 99 %:")
    steps = [row for row in found["ladder"]["effects"] if row["kind"] == "mean"]
    assert len(steps) == 2 * 2 * 4
    for row in steps:
        assert f"{row['centre']:.4g}" in text.split("The steps of kind mean")[1]
    assert max(len(line) for line in text.splitlines()) < 160


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (
            ["all.csv", "--scene", "scene.toml", "--by", "foot"],
            2,
            "column 'foot': there is no column 'foot'.",
        ),
        (["all.csv", "--by", "hand", "--other-scene", "light.toml"], 2, "leave --other-scene out"),
        (["all.csv", "left.csv", "right.csv"], 2, "one or two studies"),
        (["all.csv", "--method", "classical"], 1, "only the classical method was asked for"),
        (
            ["within.csv", "--scene", "scene.toml", "--by", "hand"],
            2,
            "'hand': says nothing that the environments",
        ),
        (
            ["all.csv", "--scene", "first.toml", "--other-scene", "last.toml"],
            1,
            "1 subject (S04) is in both",
        ),
        (["all.csv", "all.csv"], 1, "the same sessions under the same scene"),
        (
            ["unmixed.csv", "--scene", "hasty.toml"],
            1,
            "no interval of one method has a counterpart in the other. ",
        ),
    ],
)
def test_refused(folder, monkeypatch, capsys, words, code, message):
    monkeypatch.chdir(folder)
    assert main(["compare", *words, "--quiet"]) == code
    assert message in capsys.readouterr().err


ESCAPE = "\x1b[2J\u202e"


@pytest.mark.parametrize(
    "words",
    [
        ["fit", "a"],
        ["compare", "a", "b"],
        ["compare", "a", "--by", "hand"],
        ["compare", "a", "--by", f"eye{ESCAPE}"],
        ["report", "a"],
        ["fit", "a", "--json"],
        ["compare", "a", "--by", f"eye{ESCAPE}", "--json"],
    ],
    ids=" ".join,
)
def test_no_name_moves_the_terminal_s_cursor(folder, tmp_path, capsys, words):
    table = pd.read_csv(folder / "all.csv", dtype={"subject": str})
    for name in ("subject", "environment", "hand"):
        table[name] += ESCAPE
    both = pd.concat([table.assign(eye=f"open{ESCAPE}"), table.assign(eye=f"shut{ESCAPE}")])
    scatter = np.random.default_rng(1).lognormal(0.0, 0.1, len(both))
    both = both.assign(k_adj=both["k_adj"] * scatter, session=both["eye"])
    within = f"eye{ESCAPE}" in words
    (both if within else table).rename(columns={"eye": f"eye{ESCAPE}"}).to_csv(
        tmp_path / f"a{ESCAPE}.csv", index=False
    )
    table.assign(k_adj=1.1 * table["k_adj"]).to_csv(tmp_path / f"b{ESCAPE}.csv", index=False)
    files = {name: str(tmp_path / f"{name}{ESCAPE}.csv") for name in ("a", "b")}
    arguments = [files.get(word, word) for word in words]
    out = [] if words[0] == "compare" else ["--out", str(tmp_path / "out")]
    main([*arguments, "--method", "classical", *out])
    captured = capsys.readouterr()
    escaped = r"\u001b[2J\u202e" if "--json" in words else r"\x1b[2J\u202e"
    assert escaped in captured.out
    for text in (captured.out, captured.err):
        assert "\x1b" not in text
        assert "\u202e" not in text
