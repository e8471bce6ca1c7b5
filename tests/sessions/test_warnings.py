"""What is seldom meant is said, with its place, and nothing is left out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

from percept import Scene, read_sessions
from percept.sessions import (
    Sessions,
    format_validation,
    validate,
)
from tests import DATASETS, LONG

HEADER = "subject,environment,k_ref,b_ref,k_adj,b_adj"
CLEAN = [
    f"{s},{e},{k},{b},{k * (1 + s / 10)},{b * (1 - s / 20)}"
    for s in (1, 2, 3, 4)
    for e, k, b in (("soft", 100.0, 1.0), ("hard", 2000.0, 10.0))
]


def warnings_of(tmp_path, rows, options=None):
    path = tmp_path / "s.csv"
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    found = read_sessions(path, scene=options).warnings
    return [str(warning).removeprefix(f"{tmp_path}/") for warning in found]


def test_ordinary_studies_raise_none():
    for name in ("hbfd_sessions.csv", "hbfd_table1.csv"):
        assert read_sessions(DATASETS / name).warnings == ()


HARD = [f"{s},hard,2000,10,{k},{9 + s}" for s, k in ((1, 2200), (2, 2400), (3, 2400))]
FAR = "s.csv:5:k_adj: k = {} of subject '4', where the other trials of 'hard' have a median of 2400"
#: Rows, and what is said of them.
SAID = {
    "nothing": (CLEAN, []),
    "nearly far above": ([*HARD, "4,hard,2000,10,11900,13"], []),
    "far above": ([*HARD, "4,hard,2000,10,12100,13"], [FAR.format(12100) + ": mistyped?"]),
    "nearly far below": ([*HARD, "4,hard,2000,10,481,13"], []),
    "far below": ([*HARD, "4,hard,2000,10,79,13"], [FAR.format(79) + ": mistyped?"]),
    "two subjects": (
        ["1,a,100,1,9000,1.1", "2,a,100,1,110,0.9"],
        [
            "s.csv:2:k_adj: k = 9000 of subject '1', where the other trials of 'a' have a median of"
            " 110: mistyped?"
        ],
    ),
    "no logarithm": (
        [*CLEAN, "5,soft,100,1,0,1.2", "5,hard,2000,10,-3,11"],
        [
            "s.csv:10:k_adj: 2 values of k (20.0% of 10) are zero or negative, here the first: 1 of"
            " 5 in 'soft' (1 subject), 1 of 5 in 'hard' (1 subject). If people meant it, set family"
            ' = "normal" in [inference], and scale in [model] for references of zero or below. If'
            ' nobody meant it, [sessions] exclude = [{ column = "k_adj", below ='
            ' 110.00000000000001, why = "not meant" }] leaves such trials out and logs them. To'
            " leave out many biases the rest."
        ],
    ),
    "an empty cell": (CLEAN[:-1], ["1 cell has no trial: '4 at hard'"]),
    "empty cells": (
        [*CLEAN[1:3], *CLEAN[4:]],
        ["2 cells have no trial: '1 at soft', '2 at hard'"],
    ),
}


@pytest.mark.parametrize("case", SAID)
def test_what_is_seldom_meant_is_said(tmp_path, case):
    rows, said = SAID[case]
    assert warnings_of(tmp_path, rows) == said


def test_rows_of_a_filtered_table_keep_their_places(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("\n".join([HEADER, *CLEAN, "5,soft,100,1,0,1.2"]) + "\n")
    sessions = read_sessions(path)
    kept = Sessions(
        sessions.table[sessions.table["subject"] != "1"], "trials", sessions.sources,
        provenance=sessions.provenance,
    )  # fmt: skip
    assert (kept.warnings[0].row, kept.warnings[0].column) == (10, "k_adj")


def test_groups_are_not_pooled_in_silence(tmp_path):
    path = tmp_path / "s.csv"
    rows = [f"{row},{'left' if row[0] < '3' else 'right'}" for row in CLEAN]
    path.write_text("\n".join([HEADER + ",hand", *rows]) + "\n")
    (said,) = read_sessions(path, scene=Scene(sessions={"groups": ["hand"]})).warnings
    assert (
        str(said)
        == "hand: 2 groups ('left' 2 subjects, 'right' 2 subjects) are pooled: every interval is of"
        ' all groups together. [study] factor = "hand" contrasts them; "percept compare FILE --by'
        ' hand" compares two groups of different subjects.'
    )
    assert read_sessions(path, scene=Scene(study={"factor": "hand"})).warnings == ()


X = "subject,environment,x_ref,x_adj\n"
SCALE = "".join(f"{s},{r},{r},{r + s}\n" for s in range(1, 6) for r in (40, 60))
#: Text, scene, and the beginnings of what is said.
OF_SCENES = {
    "groups of subjects": (
        X + "".join(f"{s},{'ab'[s % 2]},14,{12 + s}\n" for s in range(1, 9)),
        {"quantities": {"x": {}}},
        ["each subject met one environment: environments are groups of subjects"],
    ),
    "zeros of the normal family": (
        X + "1,a,14,0\n2,a,14,-1\n3,a,14,2\n",
        {"quantities": {"x": {}}, "inference": {"family": "normal"}, "model": {"scale": {"x": 1}}},
        [],
    ),
    "a cell whose trials lie at a limit": (
        X + SCALE,
        {"quantities": {"x": {"limits": [0.0, 65.0]}}},
        ["1 cell has no trial: '5 at 60'"],
    ),
    "decibels": (
        X + SCALE,
        {"quantities": {"x": {"label": "size", "unit": "dB"}}},
        ["size in dB is a logarithm, so that ratios of its values mean nothing."],
    ),
    "angles that wrap": (
        X + "1,a,10,11\n2,a,10,355\n",
        {"quantities": {"x": {"unit": "deg"}}},
        ["x in deg reaches beyond half a turn and wraps, so that", "x = 355"],
    ),
    "angles within half a turn": (X + SCALE, {"quantities": {"x": {"unit": "deg"}}}, []),
    "errors in decibels": (
        "subject,environment,x_adj\n1,a,2.5\n2,a,-1.5\n3,a,0.5\n",
        {
            "quantities": {"x": {"unit": "dB"}},
            "environments": {"a": {"x_ref": 0.0}},
            "inference": {"family": "normal"},
            "model": {"scale": {"x": 1.0}},
        },
        [],
    ),
}


@pytest.mark.parametrize("case", OF_SCENES)
def test_what_is_said_depends_on_the_scene(tmp_path, case):
    text, tables, said = OF_SCENES[case]
    path = tmp_path / "s.csv"
    path.write_text(text)
    found = [warning.text for warning in read_sessions(path, scene=Scene(**tables)).warnings]
    assert len(found) == len(said)
    assert all(text.startswith(start) for text, start in zip(found, said, strict=True))


README_WALLS = ((560, 2.4), (610, 1.9), (530, 2.6), (640, 2.2), (585, 2.9))
WALLS = [(f"S{i}", "soft", 500.0, 2.0, float(k), b) for i, (k, b) in enumerate(README_WALLS)]


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("subjects", [2, 3, 4, None])
def test_a_digit_too_many_or_too_few_is_found_in_any_row_and_nowhere_else(subjects):
    table = Sessions.from_frame(pd.DataFrame(WALLS, columns=HEADER.split(","))).table
    table = table[table["subject"].isin(table["subject"].unique()[:subjects])]
    assert Sessions(table, "trials").slips == ()
    for index in table.index[:: 1 if LONG else 3]:
        for column, factor in (("k_adj", 10.0), ("k_adj", 0.1), ("b_adj", 10.0), ("b_adj", 0.1)):
            typed = table.copy()
            typed.loc[index, column] *= factor
            (slip,) = Sessions(typed, "trials").slips
            assert (slip.row, slip.column) == (index, column)


def test_a_slip_is_said_with_row_value_and_median(tmp_path):
    rows = [
        f"S{i},soft,500,2,{k * (10 if k == 640 else 1)},{b}"
        for i, (k, b) in enumerate(README_WALLS)
    ]
    said = "k = 6400 of subject 'S3', where the other trials of 'soft' have a median of 572.5"
    assert warnings_of(tmp_path, rows) == [f"s.csv:5:k_adj: {said}: mistyped?"]
    assert f"notice: {tmp_path}/s.csv:5:k_adj: {said}: mistyped?" in format_validation(
        validate(tmp_path / "s.csv")
    )


@pytest.mark.evidence
def test_ordinary_scatter_and_habits_are_no_slips():
    rng = np.random.default_rng(1)
    alarms = 0
    for number in range(300):
        subjects = 2 + number % 9
        sd = (0.1, 0.3, 0.5)[number % 3]
        rows = []
        for i in range(subjects):
            own = sd * rng.standard_normal()
            for name, shown in (("a", 100.0), ("b", 900.0)):
                k = shown * np.exp(own + sd * rng.standard_normal())
                rows.append((f"S{i}", name, shown, 1.0, k, 1.1))
        sessions = Sessions.from_frame(pd.DataFrame(rows, columns=HEADER.split(",")))
        alarms += bool(sessions.slips)
    assert alarms <= 6
    # One subject sets a tenth of what was shown, in every trial.
    table = sessions.table
    table.loc[table["subject"] == "S0", "k_adj"] = 0.1 * table["k_ref"]
    assert dataclasses.replace(sessions, table=table).slips == ()
