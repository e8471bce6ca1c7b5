"""Model checks from the command line: flags, files, words."""

import json

import pytest
import xarray

from percept.cli import build_parser, main
from percept.commands.analysis import open_study
from percept.scene import ChecksTable
from tests import DATASETS


@pytest.mark.parametrize(
    ("command", "flags", "scene", "checked"),
    [
        ("fit", [], "", False),
        ("fit", [], "[checks]", True),
        ("fit", ["--checks"], "", True),
        ("fit", ["--no-checks"], "[checks]", False),
        ("report", [], "", True),
        ("report", ["--no-checks"], "[checks]", False),
        ("compare", [], "[checks]", True),
    ],
)
def test_flags_go_before_the_scene(command, flags, scene, checked, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(scene)
    words = [command, str(DATASETS / "hbfd_sessions.csv"), "--scene", str(path), "--quiet", *flags]
    study = open_study(build_parser([command]).parse_args(words))
    assert study.scene.checks == (ChecksTable() if checked else None)


@pytest.fixture
def sessions(tmp_path):
    from tests.study.checked import table_of

    table = table_of(subjects=8, references=[[100.0, 1e3]], seed=2)
    table.loc[table["subject"] == table["subject"].iloc[0], "k_adj"] *= 20.0
    path = tmp_path / "sessions.csv"
    table.to_csv(path, index=False)
    return path


def test_fit_writes_and_prints_the_checks(sessions, tmp_path, capsys):
    out = tmp_path / "out"
    words = [
        "fit",
        str(sessions),
        "--out",
        str(out),
        "--tolerance",
        "0.2",
        "--seed",
        "3",
        "--no-cache",
    ]
    assert main([*words, "--method", "bayesian", "--checks"]) == 0
    printed = capsys.readouterr().out
    assert "S01 is an outlier" in printed
    document = json.loads((out / "fit.json").read_text(encoding="utf-8"))
    checks = document["checks"]
    assert set(checks) == {"normality", "loo", "without", "statistics"}
    assert [row["subject"] for row in checks["loo"]["subjects"] if row["outlier"]] == ["S01"]
    assert document["provenance"]["scene"]["checks"] == {}
    with xarray.open_datatree(out / "posterior.nc", engine="h5netcdf") as tree:
        assert {
            "log_likelihood",
            "observed_data",
            "posterior",
            "posterior_predictive",
            "prior",
            "sample_stats",
        } == set(tree.children)
