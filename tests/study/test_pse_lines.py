"""Points of subjective equality over the reference."""

import numpy as np
import pandas as pd
import pytest
from scipy import optimize, stats

from percept import Scene, Study
from percept.inference.model.predictions import new_environment
from percept.results import Skipped
from percept.sessions import Sessions


def rows_of(study):
    found = study.pse_lines
    assert not [row for row in found if isinstance(row, Skipped)]
    return pd.DataFrame(found)


@pytest.fixture(scope="module")
def lines(fitted):
    return rows_of(fitted)


def moments(fitted, parameter, reference):
    """Mean and SD of the line at one reference, given each draw of the scales."""
    fit = fitted.fit
    p = fit.parameters.index(parameter)
    tested = np.array([fitted.data.reference[parameter, name] for name in fit.environments])
    x = np.zeros(len(fit.parameters))
    x[p] = np.log10(reference) - np.log10(tested).mean()
    rng = np.random.default_rng(0)
    new = new_environment(fit.model, fit.points, x, repeats=1, rng=rng)[""]
    # A new environment lies about the line as all environments do.
    own = fit.model.scales(fit.points)["tau"][1][:, p]
    return new.mean[:, 0, p], np.sqrt(new.location[:, 0, p, p] - own**2)


@pytest.mark.parametrize("number", [0, 17, 24])
@pytest.mark.parametrize("parameter", ["k", "b"])
def test_limits_are_roots_of_the_mixture_over_draws(fitted, lines, parameter, number):
    row = lines[lines["parameter"] == parameter].iloc[number]
    mean, sd = moments(fitted, parameter, row["reference"])

    def quantile(probability):
        def excess(response):
            return stats.norm.cdf((response - mean) / sd).mean() - probability

        return optimize.brentq(excess, -9.0, 9.0, xtol=1e-12)

    expected = [quantile(0.005), mean.mean(), quantile(0.995)]
    found = np.log(row[["lower", "estimate", "upper"]].astype(float) / row["reference"])
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)


def test_a_line_is_straight_and_has_the_slope_of_the_table(fitted, lines):
    table = fitted.psychophysics
    gammas = table[(table["measure"] == "gamma")].set_index("parameter")["estimate"]
    for parameter, rows in lines.groupby("parameter"):
        bias = np.log(rows["estimate"] / rows["reference"])
        slopes = np.diff(bias) / np.diff(np.log10(rows["reference"]))
        # The table's estimate takes the same draws.
        np.testing.assert_allclose(slopes, gammas[parameter], rtol=1e-6)
    tested = [fitted.data.reference["k", name] for name in fitted.data.environments]
    assert lines["reference"].iloc[0] == pytest.approx(min(tested))
    assert lines["reference"].iloc[24] == pytest.approx(max(tested))


def study_of(references, *, levels=("",), family="lognormal", **model):
    """Four subjects, whose bias grows by .1 in the logarithm for a tenfold reference."""
    rng = np.random.default_rng(2)
    rows = []
    for subject in range(4):
        level = rng.normal(0.0, 0.1)
        for reference in references:
            for number, hand in enumerate(levels):
                size = reference or 1.0
                noise = level + 0.3 * number + rng.normal(0.0, 0.05)
                response = noise + 0.1 * np.log10(abs(size))
                adjusted = reference + size * np.expm1(response)
                rows.append([f"S{subject}", f"E{reference}", hand, reference, adjusted])
    columns = ["subject", "environment", "hand", "k_ref", "k_adj"]
    inference = {"method": "bayesian", "tolerance": 0.3, "family": family}
    scene = Scene(model=model, inference=inference)
    frame = pd.DataFrame(rows, columns=columns)
    if levels == ("",):
        frame = frame.drop(columns="hand")
    return Study(Sessions.from_frame(frame, scene=scene), scene)


@pytest.mark.evidence
def test_each_condition_has_a_line():
    lines = rows_of(study_of([1.0, 10.0, 100.0], levels=("left", "right"), bias="hand"))
    assert list(dict.fromkeys(lines["condition"])) == ["left", "right"]
    left = lines[lines["condition"] == "left"].reset_index()
    right = lines[lines["condition"] == "right"].reset_index()
    np.testing.assert_allclose(right["estimate"] / left["estimate"], np.exp(0.3), rtol=0.1)
    assert (left["n"] == 4).all()


@pytest.mark.parametrize(
    ("references", "options", "why"),
    [
        ([1.0, 10.0], {}, "it needs 3 different references, and there are 2"),
        pytest.param(
            [5.0],
            {},
            "it needs 3 different references, and there are 1",
            marks=pytest.mark.evidence,
        ),
        pytest.param(
            [0.0, 10.0, 20.0],
            {"family": "normal", "scale": {"k": 5.0}},
            "a reference of zero or below has no logarithm",
            marks=pytest.mark.evidence,
        ),
    ],
)
def test_a_study_without_a_line_says_why(references, options, why):
    study = study_of(references, **options)
    assert study.skipped_of("pse_lines") == (Skipped("line of stiffness over the reference", why),)
    assert Skipped("line of stiffness over the reference", why) in study.skipped_rows
