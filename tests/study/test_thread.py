"""The thread through the whole program on the published study."""

import dataclasses
from decimal import Decimal

import numpy as np
import pandas as pd
import pytest

from percept import RefusalError, Scene, Study, UsageError, read_sessions
from tests import DATASETS
from tests.fits import SHARED
from tests.study.within import reasons
from tests.unmixed import UNMIXED, unmixed_sessions

TABLE = pd.read_csv(DATASETS / "hbfd_table1.csv", dtype=str)


def hbfd_scene(**inference):
    return Scene.load(DATASETS / "hbfd.toml").with_inference(**inference)


def rounded_like(value, printed):
    """`value` rounded to the decimals of a printed number."""
    return Decimal(repr(float(value))).quantize(Decimal(printed))


@pytest.mark.parametrize("name", ["hbfd_sessions.csv", "hbfd_table1.csv"])
def test_classical_limits_print_as_the_published_table(name):
    study = Study(read_sessions(DATASETS / name), hbfd_scene(method="classical"))
    rows = study.intervals.query("kind == 'mean' and family == 'normal' and joint == 'marginal'")
    found = rows.set_index(["environment", "parameter"])
    for row in TABLE.itertuples():
        ours = found.loc[(row.environment, row.parameter)]
        assert rounded_like(ours["lower"], row.lower) == Decimal(row.lower)
        assert rounded_like(ours["upper"], row.upper) == Decimal(row.upper)


def test_failed_gate_withholds_the_bayesian_numbers():
    study = Study(unmixed_sessions(), hbfd_scene(**UNMIXED), store=SHARED)
    assert set(study.intervals["method"]) == {"classical"}
    assert study.posterior is None
    assert "autocorrelation times" in reasons(study)["Bayesian intervals"]


def frame(**changes):
    table = pd.read_csv(DATASETS / "hbfd_sessions.csv", dtype={"subject": str}).drop(
        columns="source"
    )
    return table.assign(**changes)


@pytest.mark.parametrize(
    ("query", "changes", "inference", "message"),
    [
        ("subject == 'S01'", {}, {}, r"at least two subjects .* only one, 'S01'"),
        (
            "environment == 'VE1'",
            {"b_ref": 0.0},
            {"family": "normal", "method": "bayesian"},
            "reference damping of VE1 is 0, which has no ratio",
        ),
    ],
)
def test_what_has_no_posterior_is_refused(query, changes, inference, message):
    table = frame(**changes).query(query)
    with pytest.raises(RefusalError, match=message):
        _ = Study(table, hbfd_scene(**inference)).fit


def test_negative_value_under_lognormal_is_refused_with_its_place():
    table = frame()
    table.loc[7, "b_adj"] = -0.5
    with pytest.raises(RefusalError, match="has no logarithm") as caught:
        _ = Study(table, hbfd_scene(method="bayesian")).fit
    assert (caught.value.row, caught.value.column, caught.value.value) == (9, "b_adj", -0.5)
    assert 'family = "normal"' in str(caught.value)


def test_what_no_session_has_is_refused():
    table = frame().drop(columns=["b_ref", "b_adj"])
    scene = Scene(inference={"parameters": ["k", "b"]})
    with pytest.raises(RefusalError, match="the scene asks for damping, which no session has"):
        _ = Study(table, scene).data.parameters
    sessions = read_sessions(DATASETS / "hbfd_sessions.csv")
    nothing = dataclasses.replace(sessions, table=sessions.table.assign(k_adj=np.nan, b_adj=np.nan))
    with pytest.raises(RefusalError, match="no adjusted value is left in the data"):
        _ = Study(nothing, Scene()).data.parameters


def test_a_study_reads_files_and_tables_as_its_scene_says(tmp_path):
    people = {"subject": ["Ann", "Ben", "Cem"], "k_adj": [560.0, 470.0, 530.0]}
    frame = pd.DataFrame(people).assign(wall="soft", k_ref=500.0)
    frame.to_csv(tmp_path / "walls.csv", index=False)
    scene = tmp_path / "scene.toml"
    scene.write_text('columns = { environment = "wall" }\ninference = { method = "classical" }\n')
    of_file = Study(tmp_path / "walls.csv", scene)
    assert of_file.sessions.environments == ("soft",)
    for given in ([tmp_path / "walls.csv"], frame):
        pd.testing.assert_frame_equal(Study(given, scene).intervals, of_file.intervals)
    with pytest.raises(UsageError, match=r"of sessions, not of int\. Give Sessions, files"):
        Study(5)
