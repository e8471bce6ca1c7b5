"""The figure of a factor's levels shows every subject, and the means that the contrasts have."""

import dataclasses

import numpy as np
import pytest
from matplotlib.figure import Figure

from percept.report.contrast import design_words
from percept.report.figures.levels import level_drawings
from percept.report.figures.output import drawn
from percept.report.select import matching
from percept.results import ContrastRow, LevelValues
from tests.documents import build_document, page_of
from tests.study.test_anova import modelled
from tests.study.within import crossed, frame, study


def results_of(made):
    return made.results(curves=False)


def axes_of(drawing):
    figure = Figure()
    drawing.draw(figure)
    return figure.axes[0]


def subjects_of(ax):
    """What is drawn of the subjects: place and height, a row per subject, without the gaps."""
    (line,) = [line for line in ax.lines if line.get_label() == "one subject"]
    x, y = line.get_data()
    return x, np.asarray(y)


def test_a_line_per_subject_and_the_means_of_the_contrasts():
    results = results_of(study(frame(9, levels=("left", "right", "both"))))
    (drawing,) = level_drawings(results)
    ax = axes_of(drawing)
    _, y = subjects_of(ax)
    overall = matching(results.levels, environment=None)
    expected = np.array([row.values for row in overall]).T
    np.testing.assert_array_equal(y.reshape(9, 4)[:, :3], expected)
    assert np.isnan(y.reshape(9, 4)[:, 3]).all()
    means = [line for line in ax.lines if str(line.get_gid()).startswith("mark-classical-mean")]
    bars = [list(line.get_ydata()) for line in means if len(line.get_ydata()) == 2]
    rows = [row for row in results.contrast if row.of == "level" and row.kind == "mean"]
    assert bars == [[row.lower, row.upper] for row in rows]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["left", "right", "both"]
    assert drawing.title == "What each subject set at the levels of hand"


def test_values_beyond_the_axis_are_marked_and_counted():
    table = frame(12)
    table.loc[table["subject"] == "S7", "k_adj"] *= 200
    results = results_of(study(table))
    (drawing,) = level_drawings(results)
    ax = axes_of(drawing)
    assert "8 values lie beyond the axis, at its end." in drawing.description
    arrows = [line for line in ax.lines if line.get_marker() == "^"]
    assert len(arrows) >= 2
    _, y = subjects_of(ax)
    assert np.nanmax(y) < 100.0 < max(max(row.values) for row in results.levels)
    assert np.isfinite(y).sum() == 24


@pytest.mark.parametrize("family", ["lognormal", "normal"])
def test_each_environment_has_a_panel_with_the_limits_of_its_cells(family):
    results = results_of(study(frame(3), family))
    (drawing,) = level_drawings(results)
    figure = Figure()
    drawing.draw(figure)
    assert [ax.get_title("left") for ax in figure.axes] == ["Stiffness k", "VE1", "VE2", "VE3"]
    for ax in figure.axes[1:]:
        _, y = subjects_of(ax)
        # Two levels and a gap for each of three subjects.
        values = y.reshape(3, 3)[:, :2]
        means = [line for line in ax.lines if str(line.get_gid()).startswith("mark-classical-mean")]
        bars = [list(line.get_ydata()) for line in means if len(line.get_ydata()) == 2]
        points = [line.get_ydata()[0] for line in means if len(line.get_ydata()) == 1]
        for place, level in enumerate(("left", "right")):
            cell = f"{ax.get_title('left')} ({level})"
            of_cell = matching(results.intervals, environment=cell, family=family)
            (row,) = matching(of_cell, kind="mean", joint="marginal")
            ends = np.array([row.lower, row.upper]) / row.reference
            centre = values[:, place].mean()
            if family == "lognormal":
                centre = np.exp(np.log(values[:, place]).mean())
            else:
                ends -= 1.0
            np.testing.assert_allclose(bars[place], ends, rtol=1e-12)
            assert points[place] == pytest.approx(centre, rel=1e-9)
    said = "Means are over all references in the first panel; every other panel is of one"
    assert f" {said} environment. " in drawing.description


def test_groups_stand_side_by_side_as_points_and_a_mixed_design_has_both():
    results = results_of(modelled(crossed(), "hand * load + group"))
    drawings = level_drawings(results)
    assert [drawing.name for drawing in drawings] == ["levels_k_1", "levels_k_2", "levels_k_3"]
    assert "panel" not in drawings[0].description
    ax = axes_of(drawings[2])
    x, y = subjects_of(ax)
    assert np.isfinite(y).sum() == 8
    assert len(np.unique(np.round(x[np.isfinite(y)]))) == 2
    assert "A line joins" in drawings[0].description
    assert "In groups, a point is the mean of one subject." in drawings[0].description


def test_a_subject_without_a_level_is_told():
    table = frame(6)
    gone = (table["subject"] == "S2") & (table["hand"] == "right")
    (drawing,) = level_drawings(results_of(study(table[~gone])))
    assert drawing.description.endswith(
        "1 subject has no value at some level, for want of a trial there."
    )


def test_both_methods_stand_beside_each_other():
    results = results_of(study(frame()))
    levels = [row for row in results.contrast if row.of == "level" and row.kind == "mean"]
    bayesian = [dataclasses.replace(row, method="bayesian") for row in levels]
    assert all(isinstance(row, ContrastRow) for row in bayesian)
    both = dataclasses.replace(results, contrast=(*results.contrast, *bayesian))
    (drawing,) = level_drawings(both)
    ax = axes_of(drawing)
    places = {}
    for line in ax.lines:
        method = str(line.get_gid()).split("-")[1:2]
        if method and len(line.get_xdata()) == 2:
            places.setdefault(method[0], []).append(round(line.get_xdata()[0], 9))
    assert places == {"classical": [0.2, 1.2], "bayesian": [0.3, 1.3]}
    assert "classical and Bayesian interval" in drawing.description


def test_it_is_the_first_figure_of_the_page():
    made = study(frame())
    results = results_of(made)
    plots = {}
    for drawing in level_drawings(results):
        _, svg = drawn(drawing, ())
        plots[drawing.name] = dataclasses.replace(drawing, svg=svg)
    page = page_of(build_document(made, curves=False), plots)
    assert page.index('id="figure-levels_k_1"') < page.index("Table 1")
    assert "Figure 1. </strong>" not in page
    assert "<strong>Figure 1. What each subject set at the levels of hand.</strong>" in page


def test_groups_count_subjects_who_lack_references():
    overall = LevelValues(
        factor="group", level="new", parameter="k", within=False, values=(None, None, None)
    )
    near = dataclasses.replace(overall, environment="near", values=(1.0, None, None))
    far = dataclasses.replace(overall, environment="far", values=(None, 2.0, None))
    results = results_of(study(frame(9, levels=("left", "right", "both"))))
    made = dataclasses.replace(results, levels=(overall, near, far))
    assert design_words(made).groups == ["2 new (group)"]
