"""What each scene imports and works out, and nothing more."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study, read_sessions
from percept.sessions import Sessions
from percept.study.prepare import prepare
from reports import dataset
from reports.benchmark.skipping import STAGES, savings, stages_of, study_without, work_of
from tests.documents import build_document

SAMPLER = {"emcee", "arviz_base", "arviz_stats", "h5netcdf", "xarray"}
PAGE = {"jinja2", "matplotlib.figure", "percept.report.figures"}
OURS = {"percept.inference.model", "percept.inference.sampling", "percept.boundary"}
CURVES = {"curve_laws", "boundaries", "verdicts", "other_devices", "coupling_map"}
BAYESIAN = {"fit", "posterior", "users"}


@pytest.mark.parametrize(
    ("scene", "left_out"),
    [
        pytest.param("nothing", set(), marks=pytest.mark.evidence),
        pytest.param("coupling", {"coupling", "coupling_map"}, marks=pytest.mark.evidence),
        ("device", CURVES | {"coupling", "regions"}),
        # Its own band law stays: the band against its reference.
        ("one parameter", CURVES | {"regions"}),
        ("all but one environment", {"band"}),
        ("page and figures", set(STAGES) - {"intervals"}),
    ],
)
def test_a_study_works_out_nothing_that_the_scene_leaves_out(scene, left_out):
    study = study_without(scene, method="classical", points=9)
    build_document(study, curves=scene != "page and figures")
    assert set(stages_of(study)) == set(STAGES) - BAYESIAN - left_out


@pytest.mark.parametrize(
    ("scene", "method", "imports", "stages", "coordinates"),
    [
        ("one parameter", "classical", PAGE, {"intervals", "coupling", "band"}, 0),
        pytest.param(
            "one parameter",
            "both",
            SAMPLER | PAGE,
            {"intervals", "fit", "posterior", "coupling", "band"},
            10,
            marks=pytest.mark.evidence,
        ),
    ],
)
def test_a_process_imports_only_what_it_needs(scene, method, imports, stages, coordinates):
    work = work_of(scene, tolerance=0.5, method=method)
    # Percept's own packages import nothing heavy.
    assert set(work["imports"]) - OURS == imports
    assert set(work["stages"]) == stages
    assert work["coordinates"] == coordinates


def coordinates_of(table, **inference):
    tables = Scene.load(dataset("hbfd.toml")).to_dict()
    tables["inference"] |= inference
    study = Study(Sessions.from_frame(table), Scene(**tables))
    return len(prepare(study.data).model.names)


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
    work = {"imports": ["emcee"], "stages": ["intervals"], "coordinates": 22}
    rounds = [
        {"nothing": work | {"seconds": whole}, "coupling": work | {"seconds": part}}
        for whole, part in ((8.0, 3.0), (9.0, 6.0), (4.0, 1.0))
    ]
    first, second = savings(rounds)
    assert (first.without, first.share) == ("nothing", 1.0)
    assert (second.seconds, second.share) == (3.0, 0.375)
    assert (second.imports, second.stages, second.coordinates) == (("emcee",), ("intervals",), 22)
