"""How bias grows with the reference: its slope, and subjects' own slopes."""

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study

SUBJECTS = 24
GAMMA = 0.15
SLOPE_SD = 0.2


def table(slope_sd=SLOPE_SD, seed=5):
    """Five references over two decades, each adjusted once by every subject."""
    rng = np.random.default_rng(seed)
    references = np.geomspace(1.0, 100.0, 5)
    decades = np.log10(references) - 1.0
    rows = []
    for subject in range(SUBJECTS):
        level = rng.normal(0.0, 0.2)
        slope = GAMMA + rng.normal(0.0, slope_sd)
        for number, reference in enumerate(references):
            response = level + slope * decades[number] + rng.normal(0.0, 0.08)
            adjusted = reference * np.exp(response)
            rows.append([f"S{subject}", f"VE{number}", reference, adjusted])
    return pd.DataFrame(rows, columns=["subject", "environment", "k_ref", "k_adj"])


def slopes(made):
    """Rows of both measures."""
    scene = Scene(inference={"method": "bayesian", "tolerance": 0.3, "level": 0.99})
    rows = Study(made, scene).psychophysics
    return rows[rows["measure"].isin(["gamma", "sigma_slope"])].set_index("measure")


def test_a_planted_slope_and_its_spread_are_found():
    """Limits hold what is planted; the estimate is that of each subject's own regression."""
    made = table()
    found = slopes(made)
    assert found.loc["gamma", "lower"] < GAMMA < found.loc["gamma", "upper"]
    assert found.loc["sigma_slope", "lower"] < SLOPE_SD < found.loc["sigma_slope", "upper"]
    responses = np.log(made["k_adj"] / made["k_ref"]).to_numpy().reshape(SUBJECTS, 5)
    own = np.polyfit(np.linspace(-1.0, 1.0, 5), responses.T, 1)[0]
    error = own.std(ddof=1) / np.sqrt(SUBJECTS)
    assert found.loc["gamma", "estimate"] == pytest.approx(own.mean(), abs=error)
    # A regression's slope has the variance 0.08²/2.5 of its own.
    spread = np.sqrt(own.var(ddof=1) - 0.08**2 / 2.5)
    assert found.loc["sigma_slope", "estimate"] == pytest.approx(spread, rel=0.2)


def test_two_references_show_the_mean_slope_only():
    """What each subject has of their own in each environment holds any trend over two."""
    made = table()
    shared = slopes(made[made["environment"].isin(["VE0", "VE4"])])
    assert list(shared.index) == ["gamma"]
