"""What each scene imports and works out, and nothing more; costs reduced; studies of a size."""

from collections.abc import Sized

import pytest

from percept import Scene, Study
from reports.benchmark.commands import (
    exponent,
    least,
    not_imported,
    study_without,
)
from reports.measure import Cost, in_a_process
from tests.documents import build_document

#: What a study works out, each only when it is asked for.
STAGES = {
    "interval_rows",
    "boundaries",
    "other_devices",
    "coupling_row",
    "verdict_rows",
    "coupling_map",
    "band",
}
CURVES = {"boundaries", "verdict_rows", "other_devices", "coupling_map"}


@pytest.mark.parametrize(
    ("scene", "left_out"),
    [
        pytest.param("nothing", set(), marks=pytest.mark.evidence),
        pytest.param("coupling", {"coupling_row", "coupling_map"}, marks=pytest.mark.evidence),
        ("device", CURVES | {"coupling_row"}),
        # Its own band law stays: the band against its reference.
        ("one parameter", CURVES),
        pytest.param("all but one environment", {"band"}, marks=pytest.mark.evidence),
    ],
)
def test_a_study_works_out_nothing_that_the_scene_leaves_out(scene, left_out):
    tables = study_without(scene, points=9).scene.to_dict()
    tables["inference"]["method"] = "classical"
    study = Study(study_without(scene).sessions, Scene(**tables))
    build_document(study)
    assert {name for name in STAGES if is_empty(vars(study).get(name))} == left_out


def is_empty(result):
    return result is None or (isinstance(result, Sized) and len(result) == 0)


@pytest.mark.parametrize(
    ("scene", "left_out"),
    [
        pytest.param(
            "bayesian",
            ["emcee", "arviz_base", "arviz_stats", "xarray"],
            marks=pytest.mark.evidence,
        ),
        pytest.param(
            "one parameter",
            ["arviz_base", "arviz_stats", "xarray"],
            marks=pytest.mark.evidence,
        ),
    ],
)
def test_a_process_imports_only_what_it_needs(scene, left_out):
    found, _ = in_a_process(not_imported, scene, 0.5)
    assert found == left_out


def test_the_least_of_each_part_counts():
    found = least({"report": [Cost(3.0, 2.0, 100.0), Cost(2.5, 2.2, 90.0)]})
    assert found == {"report": Cost(2.5, 2.0, 90.0)}


def test_the_power_that_time_goes_with():
    amounts = [10, 20, 40, 80, 160]
    assert exponent({n: 0.01 * n**1.5 for n in amounts}) == pytest.approx(1.5, rel=1e-9)
    # A start that counts for the smallest alone is left out.
    seconds = dict(zip(amounts, [9.0, 9.0, 4.0, 8.0, 16.0], strict=True))
    assert exponent(seconds) == pytest.approx(1.0, rel=1e-9)
