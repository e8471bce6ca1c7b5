"""What a study leaves out is said, whatever the data and the scene leave no room for."""

import numpy as np
import pandas as pd
import pytest
from scipy import optimize, stats

from percept import Scene, Study, read_sessions
from percept.errors import RefusalError
from percept.study.prediction import predict
from tests import DATASETS
from tests.study.within import reasons

PLACES = {"VE1": (15.0, 0.7), "VE2": (1000.0, 1.5), "VE3": (20000.0, 20.0), "VE4": (50000.0, 100.0)}
COUPLING = {"stiffness": 5e4, "damping": 100.0}
DEVICE = {"mass": 1.0, "damping": 5.0, "period": 1e-3}
BAYESIAN = {"method": "bayesian", "tolerance": 0.3}
UNPOOLED = {
    "inference": BAYESIAN,
    "model": {"pooling": "none", "prior": "reference"},
    "device": DEVICE,
}


def table(places=PLACES, subjects=6, seed=3):
    rng = np.random.default_rng(seed)
    rows = []
    for s in range(subjects):
        for place, (k, b) in places.items():
            k_adj, b_adj = np.array([k, b]) * np.exp(0.15 * rng.standard_normal(2))
            if k == b == 0:
                k_adj, b_adj = 0.1 * rng.standard_normal(2)
            rows.append([f"s{s}", place, k, b, 1, k_adj, b_adj])
    return pd.DataFrame(
        rows, columns=["subject", "environment", "k_ref", "b_ref", "trial", "k_adj", "b_adj"]
    )


def study(data, **tables):
    tables.setdefault("inference", {"method": "classical"})
    return Study(data, Scene(**tables))


def test_trials_the_pair_of_parameters_leaves_out():
    data = table({name: PLACES[name] for name in ("VE1", "VE2", "VE4")})
    data.loc[data["environment"] == "VE4", "b_adj"] = np.nan
    data.loc[(data["environment"] == "VE1") & (data["subject"] < "s2"), "b_adj"] = np.nan
    found = study(data, inference=BAYESIAN)
    why = reasons(found)
    assert why["8 trials, in the hierarchical model"] == "they lack stiffness or damping"
    assert why["Bayesian intervals of VE4"] == "no trial there has both parameters"
    assert "VE4" not in set(found.intervals["environment"])
    alone = study(data, inference={**BAYESIAN, "parameters": ["k"]})
    assert not [what for what in reasons(alone) if "trials" in what]
    assert "VE4" in set(alone.intervals["environment"])


def test_free_space_has_boundaries_and_no_band():
    data = table({"free": (0.0, 0.0), **PLACES})
    normal = {"method": "classical", "family": "normal"}
    scene = {"inference": normal, "model": {"scale": {"k": 10.0, "b": 0.5}}}
    found = study(data, device=DEVICE, frequency={"points": 11}, **scene)
    assert reasons(found)["band of free"] == "the impedance of its reference is zero"
    assert "free" not in {row.environment for row in found.band.rows}
    # The law is that of the study without it.
    without = study(data[data["environment"] != "free"], **scene).band
    assert found.band.laws == without.laws != ()
    assert "free" in {boundary.environment for boundary in found.boundaries}
    both = study(data, **{**scene, "inference": {**normal, "method": "both"}})
    message = "the reference stiffness of free is 0, and environments are compared by"
    with pytest.raises(RefusalError, match=message):
        predict(both, stiffness=1e3, damping=1.0)


def test_an_environment_without_one_reference():
    data = table()
    data.loc[data["environment"] == "VE2", ["b_ref", "b_adj"]] = np.nan
    found = study(data, device=DEVICE, frequency={"points": 11}, coupling=COUPLING)
    assert reasons(found)["boundaries and band of VE2"] == "it has no reference damping"
    assert found.with_reference == ("VE1", "VE3", "VE4")
    assert {boundary.environment for boundary in found.boundaries} == set(found.with_reference)
    assert found.coupling is not None
    shown = {row.environment for row in found.rendering if not row.coupled}
    assert shown == set(found.with_reference)


def test_a_cell_without_an_interval_costs_the_law_no_other_environment():
    data = table()
    data.loc[data["environment"] == "VE1", "b_adj"] = 0.7
    found = study(data)
    what = "classical lognormal intervals of damping in VE1"
    assert reasons(found)[what] == "all subjects made the same adjustments"
    assert {law.family for law in found.band.laws} == {"normal", "lognormal"}


@pytest.mark.parametrize(
    ("tables", "query", "what", "why"),
    [
        ({}, "environment < 'VE3'", "band law", "it needs at least 3 positive impedances"),
        (
            {"device": DEVICE},
            "subject < 's2'",
            "classical ellipses and curves through draws of VE1",
            "they need 3 subjects with both parameters; there are 2",
        ),
        (
            {"device": DEVICE | {"damping": 0.0}, "coupling": COUPLING},
            "trial == 1",
            "admissible couplings",
            "no coupling is stable in time with this device",
        ),
        (
            UNPOOLED | {"checks": {}},
            "trial == 1",
            "checks of the model",
            "they need the sessions of subjects, pooled over environments",
        ),
        (
            UNPOOLED,
            "trial == 1",
            "Bayesian ellipses and curves through draws",
            "cells without pooling hold no correlation",
        ),
    ],
)
def test_what_is_left_out_is_said_with_its_reason(tables, query, what, why):
    assert reasons(study(table().query(query), **tables))[what].startswith(why)


def test_what_published_limits_do_not_hold_is_said():
    why = reasons(
        study(
            read_sessions(DATASETS / "hbfd_table1.csv"),
            frequency={"lower": 10, "upper": 100},
        )
    )
    assert why["subject effects and k-b correlation"] == "published limits do not hold them"


def test_a_table_of_a_part_of_the_range(tmp_path):
    omega = np.geomspace(0.05, 120.0, 60)
    lines = [f"{w!r},5.0,{w!r}" for w in omega.tolist()]
    (tmp_path / "zd.csv").write_text("omega,real,imaginary\n" + "\n".join(lines) + "\n")
    device = {"response": str(tmp_path / "zd.csv"), "period": 1e-3}
    found = study(table(), device=device, coupling=COUPLING, frequency={"points": 11})
    assert found.coupling.eq10 == "undecided"
    assert {row.verdict for row in found.rendering} <= {"cannot", "undecided"}
    assert found.coupling_map is None
    why = reasons(found)
    above = "Above 120 rad/s the device's table says nothing"
    assert why["admissible couplings"].startswith(above)
    what = "verdicts with other mass and damping of the device"
    assert why[what] == "a measured response has neither"


@pytest.mark.parametrize("value", [0.0, -10.0])
@pytest.mark.parametrize("family", ["lognormal", "normal"])
def test_published_limits_about_a_reference_without_a_ratio(family, value):
    rows = [
        ["VE1", "k", value, 8.0, 12.0, 10, 0.99],
        ["VE2", "k", 100.0, 90.0, 120.0, 10, 0.99],
    ]
    columns = ["environment", "parameter", "reference", "lower", "upper", "n", "level"]
    published = pd.DataFrame(rows, columns=columns)
    found = study(published, inference={"method": "bayesian", "family": family})
    message = f"the reference stiffness of VE1 is {value:g}, which has no ratio"
    with pytest.raises(RefusalError, match=message):
        _ = found.intervals


def test_a_prior_that_rules_the_interval_is_refused():
    """The widening is tenfold, by a quadrature of its own on the scale of sigma."""
    data = table({"VE2": PLACES["VE2"]}, subjects=10)
    logs = np.log(data["k_adj"] / 1000.0)
    sigma = np.geomspace(1e-8, 10.0, 20_001)
    prior = stats.lognorm.pdf(sigma, 1.0, scale=0.2) * sigma

    def too_wide(closeness):
        sd = closeness * logs.std(ddof=1)
        density = prior * (sd / sigma) ** 9 * np.exp(-4.5 * (sd / sigma) ** 2)
        above = stats.norm.sf(10.0 * sd * stats.t.isf(0.005, 9) / sigma)
        return density @ above / density.sum() - 0.005

    closeness = optimize.brentq(too_wide, 1e-5, 1e-4)
    asked = {**BAYESIAN, "level": 0.99, "parameters": ["k"]}
    data["k_adj"] = 1000.0 * np.exp(1.001 * closeness * logs)
    assert study(data, inference=asked).prepared
    data["k_adj"] = 1000.0 * np.exp(0.999 * closeness * logs)
    with pytest.raises(RefusalError) as refused:
        _ = study(data, inference=asked).intervals
    expected = "stiffness in VE2 more than 10 times as wide as the data do"
    assert expected in str(refused.value)
    assert "lower log_s_mean in [model.priors]" in str(refused.value)
    both = study(data, inference={**asked, "method": "both"})
    assert set(both.intervals["method"]) == {"classical"}
    assert any(expected in why for why in reasons(both).values())
    told = study(
        data,
        inference=asked,
        model={"priors": {"log_s_mean": float(np.log(closeness * logs.std()))}},
    )
    assert set(told.intervals["method"]) == {"bayesian"}
