"""What the sections of a report choose from its document, and that every place leads to what stands there."""

from __future__ import annotations

import copy

import pytest

from percept.report.numbers import at
from percept.report.sections import build_parts


def part(document, name):
    return next(found for found in build_parts(document) if found.name == name).values


@pytest.fixture(params=["lognormal", "normal"])
def document(classical, request):
    """The document holds both families; the scene's is the one on the page."""
    changed = copy.deepcopy(classical)
    changed["provenance"]["scene"]["inference"]["family"] = request.param
    return changed


def test_laws_of_the_band_stand_where_their_places_say(document):
    values = part(document, "band")
    assert values["family"] == document["provenance"]["scene"]["inference"]["family"]
    assert values["laws"]
    labels = ("method", "kind", "family", "model")
    for law in values["laws"]:
        known = at(document, law["place"])
        assert [known[name] for name in labels] == [law[name] for name in labels]
        assert law["family"] == values["family"]


def test_realism_stands_where_its_places_say(document):
    realism = part(document, "coupling")["realism"]
    labels = ("environment", "kind", "method", "family", "shape")
    assert realism["rows"]
    for row in realism["rows"]:
        for method, place in row["places"].items():
            wanted = [row["environment"], row["kind"], method, realism["family"], "envelope"]
            assert [at(document, place)[name] for name in labels] == wanted


def test_every_environment_has_its_effective_impedance(classical):
    effective = part(classical, "coupling")["effective"]
    assert [row["environment"] for row in effective] == classical["data"]["environments"]


def test_environments_are_told_apart_where_their_intervals_say_different_things(classical):
    document = copy.deepcopy(classical)
    for row in document["intervals"]:
        row["covers"] = "one thing" if row["environment"] == "VE1" else "another"
    (table, *_) = part(document, "intervals")["tables"]
    told = {one["covers"]: one["environments"] for one in table["sentences"] if one["kind"] == "mean"}
    assert told == {"one thing": ["VE1"], "another": ["VE2", "VE3", "VE4", "VE5"]}


@pytest.mark.parametrize("step", [1, -1])
def test_the_law_that_predicts_best_is_quoted_wherever_it_stands(classical, step):
    document = copy.deepcopy(classical)
    document["band"]["laws"] = document["band"]["laws"][::step]
    quoted = part(document, "summary")["law"]
    alike = [
        law
        for law in classical["band"]["laws"]
        if all(law[name] == quoted[name] for name in ("kind", "method", "family"))
    ]
    assert len(alike) > 1
    assert quoted["left_out_error"] == min(law["left_out_error"] for law in alike)


def test_a_reference_is_inside_where_it_lies_between_the_limits(classical):
    document = copy.deepcopy(classical)
    document["readings"][0].update(lower=[1.0], upper=[2.0], reference=[1.5], coupled=[3.0])
    rows = part(document, "boundaries")["environments"][0]["rows"]
    (own,) = [row for row in rows if row["place"] == "/readings/0"]
    assert own["inside"] == {"reference": True, "coupled": False}
