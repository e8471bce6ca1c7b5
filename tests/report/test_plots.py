import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from percept import RefusalError, Scene, Sessions, Study, UsageError, read_sessions
from tests import DATASETS


@pytest.fixture
def ax():
    return Figure().add_subplot()


@pytest.fixture(scope="module")
def bare():
    """Without device, coupling or sampler."""
    return Study(
        read_sessions(DATASETS / "hbfd_sessions.csv"), Scene().with_inference(method="classical")
    )


def bars(ax):
    """Ends of the horizontal bars."""
    ends = (line.get_xdata() for line in ax.lines if len(line.get_xdata()) == 2)
    return {tuple(x) for x in ends if x[0] != x[1]}


def test_intervals_are_drawn_over_their_references(both_study, ax):
    assert both_study.plot_intervals("k", kinds=["mean"], ax=ax) is ax
    rows = both_study.intervals.query(
        "parameter == 'k' and kind == 'mean' and family == 'lognormal' and joint == 'marginal'"
    )
    ends = {(row.lower / row.reference, row.upper / row.reference) for row in rows.itertuples()}
    assert len(ends) == 6
    left, right = ax.get_xlim()
    kept = {pair for pair in ends if left < pair[0] and pair[1] < right}
    assert len(kept) >= 4
    assert kept <= bars(ax)
    assert [label.get_text() for label in ax.get_yticklabels()] == list(
        both_study.data.environments
    )
    assert ax.get_xlabel() == "stiffness k / reference"


def test_without_axes_a_new_figure_is_shown(bare):
    ax = bare.plot_intervals("b")
    try:
        assert plt.gcf() is ax.figure
    finally:
        plt.close(ax.figure)


def test_a_boundary_is_drawn_as_it_is_computed(both_study, ax):
    assert both_study.plot_boundary("VE4", ax=ax) is ax
    wanted = {
        "environment": "VE4",
        "method": "classical",
        "kind": "user",
        "family": "lognormal",
        "joint": "marginal",
        "shape": "envelope",
    }
    drawn = {line.get_label(): line.get_xydata() for line in ax.lines}
    (one,) = (
        boundary
        for boundary in both_study.boundaries
        if all(getattr(boundary, name) == value for name, value in wanted.items())
    )
    np.testing.assert_array_equal(
        drawn["classical, envelope (lognormal)"], np.c_[one.omega, one.lower]
    )
    np.testing.assert_array_equal(drawn["reference"], np.c_[one.omega, one.reference])
    assert ax.get_title() == "|Zₕ| of VE4 (N·s/m), kind user"


def test_the_band_is_drawn_at_its_impedances(both_study, ax):
    assert both_study.plot_band(ax=ax) is ax
    rows = pd.DataFrame(both_study.band.rows)
    rows = rows.query("family == 'lognormal' and method == 'bayesian'")
    points = [line.get_xydata()[0] for line in ax.lines if line.get_marker() == "D"]
    # Both methods stand beside the size, so that neither hides the other.
    beside = rows[["impedance", "band"]].to_numpy() * [1.04, 1.0]
    np.testing.assert_allclose(points, beside, rtol=1e-12)
    with pytest.raises(UsageError, match="'x': there is no band of it"):
        both_study.plot_band("x", ax=ax)


@pytest.mark.parametrize(
    ("plot", "message"),
    [
        (
            lambda study: study.plot_boundary("VE1"),
            r"the study has no boundary\. study\.skipped says why",
        ),
        (lambda study: study.plot_coupling(), "there is no coupling. Give the scene a"),
    ],
    ids=["boundary", "coupling"],
)
def test_what_is_not_there_is_refused(bare, plot, message):
    with pytest.raises(RefusalError, match=message):
        plot(bare)


def test_names_the_study_does_not_have_are_told(both_study, bare):
    with pytest.raises(
        UsageError, match="'VE9': the study has no such environment; there are VE1, VE2, VE4"
    ):
        both_study.plot_boundary("VE9")
    with pytest.raises(UsageError, match="'m': the study has no such parameter; there are k, b"):
        bare.plot_intervals("m")
    with pytest.raises(
        UsageError, match="'all': the study has no such kind; there are mean, user, share"
    ):
        bare.plot_intervals(kinds=["all"])


def test_a_dollar_sign_in_a_name_is_text(bare, ax):
    table = bare.sessions.table.assign(environment=bare.sessions.table["environment"] + " $x_1$")
    Study(Sessions.from_frame(table), bare.scene).plot_intervals("k", ax=ax)
    assert not any(label.get_parse_math() for label in ax.get_yticklabels())


def test_zero_and_negative_references_are_drawn_as_differences(ax):
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    table = table[["subject", "session", "trial", "environment", "k_ref", "k_adj"]].copy()
    table["k_adj"] -= table["k_ref"] + 50.0
    table["k_ref"] = -50.0
    study = Study(Sessions.from_frame(table), Scene(inference={"method": "classical"}))
    study.plot_intervals("k", kinds=["mean"], ax=ax)
    rows = study.intervals.query("kind == 'mean' and family == 'normal' and joint == 'marginal'")
    ends = {(row.lower + 50.0, row.upper + 50.0) for row in rows.itertuples()}
    assert len(ends & bars(ax)) >= 3
    assert ax.get_xlabel() == "stiffness k − reference (N/m)"
    assert ax.get_xscale() == "linear"
    assert [0.0, 0.0] in [list(line.get_xdata()) for line in ax.lines]


def test_a_legend_is_drawn_on_new_figures_alone(bare, ax):
    bare.plot_intervals("k", ax=ax)
    assert ax.get_legend() is None
    assert ax.get_title() == "Stiffness k"
    new = bare.plot_intervals("k")
    try:
        labels = [text.get_text() for text in new.get_legend().get_texts()]
        assert {"one subject", "classical", "average user"} <= set(labels)
    finally:
        plt.close(new.figure)


@pytest.mark.parametrize("style", ["default", "dark_background"])
def test_what_is_drawn_shows_in_the_reader_s_style(both_study, style):
    with plt.style.context(style):
        ground = np.array(to_rgb(plt.rcParams["axes.facecolor"]))
        environment = both_study.data.environments[0]
        for plot, words in (
            (both_study.plot_intervals, ()),
            (both_study.plot_boundary, (environment,)),
            (both_study.plot_band, ()),
            (both_study.plot_coupling, ()),
        ):
            ax = Figure().add_subplot()
            plot(*words, ax=ax)
            for line in ax.get_lines():
                assert np.abs(np.array(to_rgb(line.get_color())) - ground).max() > 0.35
            for text in ax.texts:
                box = text.get_bbox_patch()
                behind = ground if box is None else np.array(box.get_facecolor()[:3])
                assert np.abs(np.array(to_rgb(text.get_color())) - behind).max() > 0.35
