"""Layouts without a column of subjects or environments, and lines as some programs end them."""

from __future__ import annotations

import numpy as np
import pytest

from percept.errors import UsageError
from percept.sessions import ReadOptions, read_sessions


def read(tmp_path, text, name="f.csv", **tables):
    path = tmp_path / name
    path.write_bytes(text.encode())
    return read_sessions(path, scene=ReadOptions(**tables))


def texts(sessions):
    return [notice.text for notice in sessions.notices]


def test_values_of_a_reference_name_environments(tmp_path):
    found = read(tmp_path, "subject,k_ref,k_adj\n1,300,310\n1,900,880\n2,300,290\n2,900,950\n")
    assert found.environments == ("300", "900")
    assert texts(found) == ["environments are named by the values of column 'k_ref'"]


def test_one_declared_environment_needs_no_column(tmp_path):
    text = "subject,k_adj\n1,310\n2,290\n"
    found = read(tmp_path, text, environments={"wall": {"k_ref": 300.0}})
    assert found.environments == ("wall",)
    assert found.table["k_ref"].tolist() == [300.0, 300.0]
    two = {"wall": {"k_ref": 300.0}, "floor": {"k_ref": 900.0}}
    with pytest.raises(UsageError, match="there is no column for environment"):
        read(tmp_path, text, environments=two)


def test_a_mistyped_column_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"no column for k_adj; .* Did you mean k_ajd"):
        read(tmp_path, "subject,environment,k_ref,b_ref,k_ajd,b_adj\n1,a,5,2,6,3\n")


def test_a_name_of_the_file_goes_before_the_values_of_a_reference(tmp_path):
    text = "subject,k_ref,k_adj\n1,300,310\n2,300,290\n"
    found = read(tmp_path, text, name="soft.csv", sessions={"filename": "{environment}"})
    assert found.environments == ("soft",)
    assert not any("named by the values" in text for text in texts(found))


def test_each_row_of_a_wide_table_may_be_a_subject(tmp_path):
    options = {
        "columns": {"k_adj": "{environment}"},
        "environments": {"soft": {"k_ref": 300.0}, "hard": {"k_ref": 900.0}},
        "sessions": {"subject": "row"},
    }
    found = read(tmp_path, "soft,hard,age\n310,880,30\n290,,31\n330,910,32\n", **options)
    assert found.subjects == ("f 2", "f 3", "f 4")
    assert found.table["k_adj"].tolist() == [310.0, 880.0, 290.0, 330.0, 910.0]
    # Rows of two files are different people.
    (tmp_path / "g.csv").write_text("soft,hard\n300,900\n")
    found = read_sessions(tmp_path, scene=ReadOptions(**options))
    assert found.subjects == ("f 2", "f 3", "f 4", "g 2")


def test_columns_between_spaces_are_told_apart(tmp_path):
    text = "subject environment k_ref k_adj\n1 a 300 310.5\n2 a 300 290.25\n"
    assert read(tmp_path, text).table["k_adj"].tolist() == [310.5, 290.25]
    # Names with spaces between commas are no mark of it.
    text = "subject,environment,k ref,k adj\n1,a b,300,310.5\n2,a b,300,290.25\n"
    assert read(tmp_path, text).environments == ("a b",)


@pytest.mark.parametrize("rows", [3, 9000])
def test_two_carriage_returns_and_a_line_feed_end_a_line(tmp_path, rows):
    lines = [f"{row},a,300,{300 + row / 8},{'x' * 40}" for row in range(rows)]
    text = "\r\r\n".join(["subject,environment,k_ref,k_adj,note", *lines, ""])
    found = read(tmp_path, text)
    assert found.table["k_adj"].tolist() == [300 + row / 8 for row in range(rows)]
    assert "blank line" not in found.counts


RESPONSES = {
    "ratio": [1.1, 0.9],
    "difference": [30.0, -30.0],
}


@pytest.mark.parametrize("response", RESPONSES)
def test_an_adjustment_may_be_given_against_its_reference(tmp_path, response):
    values = RESPONSES[response]
    rows = "".join(f"{s},a,300,{value}\n" for s, value in enumerate(values))
    text = f"subject,environment,k_ref,x\n{rows}"
    columns = {"k_adj": {"name": "x", "response": response}}
    found = read(tmp_path, text, columns=columns)
    np.testing.assert_allclose(found.table["k_adj"], [330.0, 270.0], rtol=1e-15)
    # The reference may stand in the scene.
    bare = text.replace(",k_ref", "").replace(",300", "")
    found = read(tmp_path, bare, columns=columns, environments={"a": {"k_ref": 300.0}})
    np.testing.assert_allclose(found.table["k_adj"], [330.0, 270.0], rtol=1e-15)
    # A difference has a unit of its own.
    if response == "difference":
        columns["k_adj"]["unit"] = "N/mm"
        thousandth = text.replace("30.0", "0.03")
        found = read(tmp_path, thousandth, columns=columns)
        np.testing.assert_allclose(found.table["k_adj"], [330.0, 270.0], rtol=1e-15)


def test_decibels_are_logarithms(tmp_path):
    # 20 dB more is ten times the amplitude.
    text = "subject,environment,p_ref,p_adj\n1,a,60,80\n2,a,60,66\n"
    rule = {"scale": 0.05, "response": "log"}
    columns = {name: {"name": name, **rule} for name in ("p_ref", "p_adj")}
    found = read(tmp_path, text, quantities={"p": {"unit": ""}}, columns=columns)
    np.testing.assert_allclose(found.table["p_ref"], [1e3, 1e3], rtol=1e-14)
    np.testing.assert_allclose(found.table["p_adj"], [1e4, 10**3.3], rtol=1e-14)


def test_a_unit_without_a_name_is_a_factor(tmp_path):
    text = "subject,environment,k_ref,k_adj\n1,a,300,31\n2,a,300,29\n"
    columns = {"k_adj": {"name": "k_adj", "scale": 10.0, "offset": 1.0}}
    assert read(tmp_path, text, columns=columns).table["k_adj"].tolist() == [320.0, 300.0]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"k_ref": {"name": "x", "response": "ratio"}}, "only an adjustment is a ratio"),
        ({"k_adj": {"name": "x", "response": "log", "unit": "N/m"}}, "have no unit"),
        ({"k_adj": {"name": "x", "response": "sum"}}, "must be 'ratio', 'difference' or 'log'"),
        ({"k_adj": {"name": "x", "scale": 0.0}}, "scale must not be zero"),
    ],
)
def test_responses_that_make_no_quantity_are_refused(columns, message):
    with pytest.raises(UsageError, match=message):
        ReadOptions(columns=columns)
