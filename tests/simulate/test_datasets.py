"""The data sets that come with percept: true to print, true to their seed, true to their
description."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import Scene, Study, read_sessions
from percept.cli import main
from percept.published import BETWEEN, CORRELATION
from tests import DATASETS
from tests.documents import build_document, page_of
from tests.simulate.conftest import correlations, printed_limits

SESSIONS = DATASETS / "hbfd_sessions.csv"

# Table 1 of the paper, typed from its page.
PRINTED = {
    ("VE1", "k"): ("10", "10.808", "19.02"),
    ("VE1", "b"): ("0.1", "0.0356", "1.3335"),
    ("VE2", "k"): ("1000", "944.85", "1017.2"),
    ("VE2", "b"): ("1", "1.2404", "1.5316"),
    ("VE3", "k"): ("10000", "8979.9", "9954.1"),
    ("VE3", "b"): ("10", "8.188", "13.146"),
    ("VE4", "k"): ("25000", "23316", "24968"),
    ("VE4", "b"): ("25", "21.447", "27.549"),
    ("VE5", "k"): ("50000", "39498", "47829"),
    ("VE5", "b"): ("50", "79.933", "112.34"),
}


def cells(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_table_1_is_as_printed() -> None:
    rows = cells(DATASETS / "hbfd_table1.csv")
    found = {
        (row["environment"], row["parameter"]): (row["reference"], row["lower"], row["upper"])
        for row in rows
    }
    assert list(found) == list(PRINTED)
    assert found == PRINTED
    assert len(rows) == 10
    assert {(row["n"], row["level"]) for row in rows} == {("10", "0.99")}


@pytest.mark.parametrize(("environment", "parameter"), PRINTED)
def test_sessions_give_the_printed_limits(environment: str, parameter: str) -> None:
    reference, lower, upper = PRINTED[environment, parameter]
    rows = [row for row in cells(SESSIONS) if row["environment"] == environment]
    assert {row[f"{parameter}_ref"] for row in rows} == {reference}
    values = [row[f"{parameter}_adj"] for row in rows]
    assert len(values) == 10
    assert printed_limits(values, "0.99", (lower, upper)) == (lower, upper)


def test_sessions_come_from_their_seed(tmp_path: Path) -> None:
    again = tmp_path / "again.csv"
    words = ["simulate", "--like", str(DATASETS / "hbfd_table1.csv"), "--seed", "1"]
    assert main([*words, "--out", str(again)]) == 0
    assert again.read_bytes() == SESSIONS.read_bytes()
    # A file stays as it is.
    assert main([*words, "--out", str(again)]) == 2


def test_the_description_has_the_columns_and_the_correlations() -> None:
    text = (DATASETS / "README.md").read_text(encoding="utf-8")
    for name in ("hbfd_table1", "hbfd_sessions", "illusions", "sleep", "stools", "growth"):
        for column in cells(DATASETS / f"{name}.csv")[0]:
            assert f"`{column}`" in text, (name, column)
    within, across = correlations(pd.read_csv(SESSIONS))
    assert f"| {CORRELATION} | {within:.4f} |" in text
    assert f"| {BETWEEN} | {across:.4f} |" in text
    # One correlation of ten subjects has a standard error near 0.3; these averages are far nearer.
    assert abs(within - CORRELATION) < 0.01
    assert abs(across - BETWEEN) < 0.01


def test_measured_offsets_have_scipys_limits_and_a_page_of_their_own_words() -> None:
    """Zero, negative and missing settings of a study that nobody here made."""
    scene = Scene.load(DATASETS / "illusions.toml").with_inference(method="classical")
    study = Study(read_sessions(DATASETS / "illusions.csv", scene=scene), scene)
    table = pd.read_csv(DATASETS / "illusions.csv").set_index("Part_ID")
    assert table.loc[20, "FD"] == 0.0
    assert study.data.environments == ("FLE", "Froh", "FD", "FG", "MIPS", "TG", "FJ")
    for row in study.intervals.query("family == 'normal' and joint == 'marginal'").itertuples():
        values = table[row.environment].dropna()
        scale = {"mean": stats.sem(values), "user": values.std() * (1 + 1 / len(values)) ** 0.5}
        if row.kind in scale:
            limits = stats.t.interval(0.95, len(values) - 1, values.mean(), scale[row.kind])
            np.testing.assert_allclose((row.lower, row.upper), limits, rtol=1e-12)
    page = page_of(build_document(study)).split("<script")[0].split("<main")[1]
    # What percept is called in a bibliography is no word of the study.
    text = re.sub("(?s)<pre.*?</pre>|<[^>]*>", "", page.split('id="data"')[0])
    assert "43 participants set offset in 7 illusions, once each" in text
    headline = (
        "Participants set offset above zero in all 7 illusions, from FD (+0.069 deg, +0.0467 to"
        " +0.0913 deg) to FG"
        " (+4.59 deg, +4.09 to +5.08 deg) (classical, 95 %)."
    )
    assert headline in text
    assert "– to –" not in text
    assert not re.search(r"tiffness|damping|impedance|oupling|N/m|aptic", text)


@pytest.mark.parametrize("name", ["percact", "intervals", "sleep", "stools", "growth"])
def test_scenes_of_public_files_load_and_are_described(name: str) -> None:
    scene = Scene.load(DATASETS / f"{name}.toml")
    assert scene.study is not None
    text = (DATASETS / "README.md").read_text(encoding="utf-8")
    assert f"--scene datasets/{name}.toml" in text
    assert scene.study.factor is None or f"`{scene.study.factor}`" in text
