"""The figure of a factor's levels shows every subject, and the means that the contrasts have."""

import dataclasses

import numpy as np
import pytest
from matplotlib.figure import Figure

from percept.report.basics import distinct, matching
from percept.report.figures.intervals import level_drawings
from percept.report.methods import who_gave_what
from percept.results import LevelValues
from tests.study.within import crossed, frame, study


def results_of(made):
    return made.results(curves=False)


def axes_of(drawing):
    figure = Figure(layout="constrained")
    drawing.draw(figure)
    return figure.axes


def subjects_of(ax):
    """What is drawn of the subjects: place and height, a row per subject, without the gaps."""
    (line,) = [line for line in ax.lines if line.get_label() == "one subject"]
    x, y = line.get_data()
    return x, np.asarray(y)


def intervals_of(ax):
    """Limits of the upright intervals."""
    lines = [line.get_data() for line in ax.lines]
    return [tuple(y) for x, y in lines if len(y) == 2 and x[0] == x[1]]


def test_a_line_per_subject_and_the_means_of_the_contrasts():
    results = results_of(study(frame(9, levels=("left", "right", "both"))))
    (drawing,) = level_drawings(results)
    (ax,) = axes_of(drawing)
    _, y = subjects_of(ax)
    overall = matching(results.levels, environment=None)
    expected = np.array([row.values for row in overall]).T
    np.testing.assert_array_equal(y.reshape(9, 4)[:, :3], expected)
    assert np.isnan(y.reshape(9, 4)[:, 3]).all()
    rows = [row for row in results.contrast if row.of == "level" and row.kind == "mean"]
    assert intervals_of(ax) == [(row.lower, row.upper) for row in rows]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["left", "right", "both"]


def test_levels_stand_in_the_unit_of_the_data():
    table = frame(6).query("environment == 'VE1'")
    results = results_of(study(table, "normal"))
    (drawing,) = level_drawings(results)
    (ax,) = axes_of(drawing)
    assert ax.get_ylabel() == "stiffness − reference (N/m)"
    reference = table["k_ref"].iloc[0]
    rows = [row for row in results.contrast if (row.of, row.kind) == ("level", "mean")]
    ends = [(reference * row.lower, reference * row.upper) for row in rows]
    assert intervals_of(ax) == [pytest.approx(one) for one in ends]


def test_groups_stand_side_by_side_and_colour_the_lines_of_the_others():
    results = results_of(study(crossed(), bias="hand * load + group"))
    drawings = level_drawings(results)
    assert [drawing.name for drawing in drawings] == ["levels_k_1", "levels_k_2", "levels_k_3"]
    of_group = axes_of(drawings[2])[0]
    x, y = subjects_of(of_group)
    assert np.isfinite(y).sum() == 8
    assert len(np.unique(np.round(x[np.isfinite(y)]))) == 2
    groups = distinct(matching(results.levels, within=False), "level")
    lines = {line.get_label(): line for line in axes_of(drawings[0])[0].lines}
    assert len({lines[name].get_color() for name in groups}) == len(groups) == 2


def test_groups_count_subjects_who_lack_references():
    overall = LevelValues(
        factor="group", level="new", parameter="k", within=False, values=(None, None, None)
    )
    near = dataclasses.replace(overall, environment="near", values=(1.0, None, None))
    far = dataclasses.replace(overall, environment="far", values=(None, 2.0, None))
    results = results_of(study(frame(9, levels=("left", "right", "both"))))
    made = dataclasses.replace(results, levels=(overall, near, far))
    assert who_gave_what(made).endswith("Subjects by group: new 2.")
