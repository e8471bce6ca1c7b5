"""What each scene imports and works out, and nothing more."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study, read_sessions
from percept.bench.skipping import PACKAGES, STAGES, skipping_cost, work_of
from percept.reproduce.published import dataset
from percept.sessions import Sessions
from percept.study.fit import prepare

SAMPLER = {"emcee", "h5netcdf", "xarray"}
ARVIZ = {"arviz_base", "arviz_stats"}
PAGE = {"jinja2", "matplotlib.figure", "percept.report.figures"}
OURS = {"percept.inference.hierarchy", "percept.inference.sampling", "percept.boundary"}
CURVES = {"curve_laws", "boundaries", "sensitivity", "coupling_design"}
BAYESIAN = {"fit", "posterior", "realism"}


def quick(scene, method):
    found = work_of(scene, tolerance=0.5, points=9, method=method)
    return set(found["imports"]), set(found["stages"]), found["coordinates"]


@pytest.mark.parametrize(
    ("scene", "left_out"),
    [
        ("nothing", set()),
        ("coupling", {"coupling", "coupling_design"}),
        ("device", CURVES | {"coupling", "regions"}),
        ("one parameter", CURVES | {"regions", "band"}),
        ("all but one environment", {"band"}),
    ],
)
def test_the_classical_page_does_without_what_the_scene_leaves_out(scene, left_out):
    imports, stages, coordinates = quick(scene, "classical")
    assert stages == set(STAGES) - BAYESIAN - left_out
    assert not imports & (SAMPLER | ARVIZ)
    assert imports >= PAGE
    assert coordinates == 0


def test_a_fit_draws_nothing():
    imports, stages, _ = quick("page and figures", "classical")
    assert stages == {"intervals"}
    assert not imports & (SAMPLER | PAGE | ARVIZ)


def test_both_methods_take_it_all_and_the_classical_scene_takes_the_rest():
    imports, stages, coordinates = quick("nothing", "both")
    assert stages == set(STAGES)
    assert imports == SAMPLER | PAGE | OURS
    assert coordinates == 22
    assert quick("bayesian", "both")[1] == stages - BAYESIAN


def coordinates_of(table, **inference):
    tables = Scene.load(dataset("hbfd.toml")).to_dict()
    tables["inference"] |= inference
    study = Study(Sessions.from_frame(table), Scene.from_tables(tables))
    return len(prepare(study.sessions, study.scene, study.parameters).model.names)


def test_the_model_has_no_level_that_the_data_or_the_scene_leave_out():
    table = read_sessions(dataset("hbfd_sessions.csv")).table
    again = table.assign(trial=2)
    again["k_adj"] *= 1.0 + 0.04 * np.cos(np.arange(len(table)))
    again["b_adj"] *= 1.0 + 0.04 * np.sin(np.arange(len(table)))
    repeated = pd.concat([table.assign(trial=1), again], ignore_index=True)
    one = table[table["environment"] == "VE3"]
    # k and b: tau, sigma_u, s, kappa, omega each, two correlations, and a spread per environment.
    assert coordinates_of(table) == 2 * 5 + 2 + 2 * 5
    # Trials: s, kappa and omega of each, a correlation, and a spread per environment.
    assert coordinates_of(repeated) == 22 + 2 * 3 + 1 + 2 * 5
    assert coordinates_of(table, parameters=["k"]) == 5 + 5
    # One environment: two spreads and one correlation.
    assert coordinates_of(one) == 3


def test_savings_are_shares_of_leaving_nothing_out():
    found = skipping_cost(
        repeats=1, tolerance=0.5, scenes=("bayesian", "page and figures"), method="classical"
    )
    assert [one.without for one in found] == ["bayesian", "page and figures"]
    assert found[0].share == 1.0
    assert found[1].share == found[1].seconds / found[0].seconds
    assert found[1].stages == ("intervals",)
    assert set(found[0].imports) <= set(PACKAGES)
