from __future__ import annotations

import json
import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from percept.results import dumps, plain


@dataclass(frozen=True)
class Record:
    name: str
    curve: np.ndarray


def test_records_arrays_and_tables_become_json_values():
    value = {
        "record": Record("a", np.array([1.0, np.inf, -np.inf, np.nan])),
        "table": pd.DataFrame({"x": [1, 2], "y": ["a", None]}),
        "pair": (np.float64(0.1), np.int64(3), np.bool_(True)),
        "nothing": None,
    }
    assert plain(value) == {
        "record": {"name": "a", "curve": [1.0, "inf", "-inf", None]},
        "table": [{"x": 1, "y": "a"}, {"x": 2, "y": None}],
        "pair": [0.1, 3, True],
        "nothing": None,
    }


@pytest.mark.parametrize("hidden", ["\x1b[2J", "\x9b2J", "\x85", "\u202e", "\u2066", "\u2028"])
def test_what_a_terminal_obeys_is_escaped_and_reads_back(hidden):
    document = {f"k{hidden}": [f"a{hidden}é"]}
    text = dumps(document)
    assert text.replace("\n", "").isprintable()
    assert "é" in text
    assert json.loads(text) == document


def test_what_has_no_plain_form_is_refused():
    with pytest.raises(TypeError, match="object has no plain form"):
        plain({"x": object()})


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False)))
def test_every_double_survives_the_text(values):
    read = json.loads(dumps({"x": plain(np.array(values))}))["x"]
    assert [math.copysign(1, v) for v in read] == [math.copysign(1, v) for v in values]
    assert read == values


@settings(max_examples=40)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.text(),
        lambda part: st.lists(part) | st.dictionaries(st.text(), part),
        max_leaves=20,
    )
)
def test_text_reads_back_whatever_the_nesting(value):
    assert json.loads(dumps({"x": value})) == {"x": value}


def test_a_nan_that_slipped_through_is_not_written():
    with pytest.raises(ValueError, match="not JSON compliant"):
        dumps({"x": [float("nan")]})
