import json

import pytest

from percept.cli import main
from tests import DATASETS

SESSIONS = str(DATASETS / "hbfd_sessions.csv")
LESS = ["--tolerance", "0.1", "--quiet"]
TABLE = str(DATASETS / "hbfd_table1.csv")
LOOSE = [TABLE, "--scene", str(DATASETS / "hbfd.toml"), "--tolerance", "0.2", "--quiet"]


def test_extrapolation_is_said_in_both_forms(capsys):
    words = ["predict", *LOOSE, "--k", "1e6", "--b", "12"]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert text.startswith("Extrapolation: stiffness lies 1.3 decades above the tested range.\n")
    assert [line.split(":")[0] for line in text.splitlines()[-4:-1]] == ["mean", "user", "share"]
    assert "6 boundaries of abs(Z_h)" in text
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["extrapolates"] is True
    assert text.startswith(found["sentence"])
    assert len(found["boundaries"]) == 6
    for row in found["intervals"]:
        assert f"{row['lower']:.6g}" in text


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (
            ["--k", "1e4"],
            2,
            "damping of the new environment must be a positive number of N·s/m. Give it.",
        ),
        (
            ["--k", "-1", "--b", "1"],
            2,
            "stiffness of the new environment must be a positive number",
        ),
        (["--k", "1e4", "--b", "1", "--method", "classical"], 1, "classical method has no model"),
    ],
)
def test_refused_before_anything_is_sampled(words, code, message, capsys):
    assert main(["predict", *LOOSE, *words]) == code
    assert message in capsys.readouterr().err


def test_the_error_of_limits_is_told_and_grows_away_from_the_tested_environments(capsys):
    """Far outside them limits rest on few draws of the fit's scales."""
    errors = []
    for stiffness, damping in (("1e4", "10"), ("1e9", "1e5")):
        words = ["predict", SESSIONS, "--k", stiffness, "--b", damping, "--json", *LESS]
        assert main(words) == 0
        captured = capsys.readouterr()
        assert captured.err == ""
        rows = json.loads(captured.out)["intervals"]
        errors.append(max(row["monte_carlo"] for row in rows))
    assert errors[0] <= 0.1
    assert errors[0] < errors[1] < 0.3
