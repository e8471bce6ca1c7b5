"""The map of couplings by the paper's rule, as drawn."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from reports.hbfd.figures import CouplingMarks, draw_design


def axes():
    return Figure().add_subplot()


def test_the_map_shades_every_interval_of_every_line():
    ax = axes()
    intervals = [np.array([[0.0, 1e3]]), np.array([[0.0, 1e3], [2e3, 3e3]]), np.empty((0, 2))]
    draw_design(ax, np.array([0.0, 1.0, 2.0]), intervals, CouplingMarks(coupling=(5e3, 4.0)))
    (shade,) = ax.patches
    boxes = [(*box.min(axis=0), *box.max(axis=0)) for box in shade.get_path().to_polygons()]
    assert boxes == [(0.0, 0.0, 1.0, 0.5), (0.0, 0.5, 1.0, 1.5), (2.0, 0.5, 3.0, 1.5)]
    (mark,) = [line for line in ax.get_lines() if line.get_marker() == "X"]
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == (5.0, 4.0)


def test_a_map_of_couplings_shows_what_qualifies_however_far_the_one_in_use():
    ax = axes()
    intervals = [np.array([[0.0, 1e3]]), np.array([[0.0, 2e3]])]
    draw_design(ax, np.array([0.0, 1.0]), intervals, CouplingMarks(coupling=(5e5, 900.0)))
    assert ax.get_xlim() == pytest.approx((0.0, 1.05 * 4.0 * 2.0))
    assert ax.get_ylim() == pytest.approx((0.0, 1.05 * 4.0 * 1.0))
    (mark,) = [line for line in ax.get_lines() if line.get_marker() == "X"]
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == pytest.approx((8.4, 4.2))
    assert not mark.get_clip_on()
    assert [text.get_text() for text in ax.texts] == ["at 500 kN/m,\n900 N·s/m"]
    empty = axes()
    draw_design(
        empty, np.array([0.0, 1.0]), [np.empty((0, 2))] * 2, CouplingMarks(coupling=(5e3, 4.0))
    )
    assert [text.get_text() for text in empty.texts] == ["none qualifies"]
    assert empty.get_xlim()[1] > 5.0
