"""Twelve studies give the numbers they gave when these were frozen; `make test` takes three of
them, and the classical numbers of the published one."""

from __future__ import annotations

import copy
import functools
import json
import math
from typing import Any

import pytest

from tests import LONG
from tests.golden.compare import EXACT, FAR, POINTWISE, differences
from tests.golden.studies import FOLDER, STUDIES, frozen_part


@functools.cache
def frozen(name: str) -> Any:
    return json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


#: A study of one parameter, one of one environment and one with a factor.
QUICK = ("one_parameter", "one_environment", "stools")
TAKEN = [golden for golden in STUDIES if LONG or golden.name in QUICK]


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("golden", TAKEN, ids=lambda golden: golden.name)
def test_numbers_are_as_frozen(golden):
    now = frozen_part(golden, golden.report())
    now = json.loads(json.dumps(now))
    assert differences(frozen(golden.name), now) == []
    assert now["skipped"] == frozen(golden.name)["skipped"]


def test_classical_numbers_of_the_published_study_are_as_frozen():
    (golden,) = (one for one in STUDIES if one.name == "published")
    now = frozen_part(golden, golden.report(method="classical"))
    classical = {**frozen(golden.name), "endpoints": {}}
    assert len(classical["exact"]) > 100
    assert differences(classical, json.loads(json.dumps(now))) == []


@pytest.mark.parametrize(
    ("part", "name", "tolerance"),
    [
        ("exact", "interval VE1 k mean normal marginal", EXACT),
        ("exact", "coupling margin", EXACT),
        ("exact", "realism VE1 mean normal marginal corner effective", EXACT),
        ("exact", "law mean normal offset c", EXACT),
        ("exact", "sensitivity required_damping", EXACT),
        ("curves", "envelope VE1 user lognormal hotelling", EXACT),
        ("curves", "pointwise VE1 user lognormal joint", POINTWISE),
    ],
)
def test_a_perturbed_number_is_caught(part, name, tolerance):
    old = frozen("published")
    for factor, caught in ((1.0 + 0.2 * tolerance, False), (1.0 + 3.0 * tolerance, True)):
        new = copy.deepcopy(old)
        new[part][name] = scaled(old[part][name], factor)
        found = differences(old, new)
        assert all(text.startswith(name) for text in found)
        assert bool(found) == caught


def scaled(value: Any, factor: float) -> Any:
    if isinstance(value, dict):
        return {key: scaled(inner, factor) for key, inner in value.items()}
    if isinstance(value, list):
        return [scaled(inner, factor) for inner in value]
    return value * factor


@pytest.mark.parametrize("study", ["published", "no_pooling"])
def test_an_endpoint_too_far_is_caught(study):
    """One family is compared on the log scale, the other on its own."""
    old = frozen(study)
    name = next(iter(old["endpoints"]))
    at = old["endpoints"][name]
    low, high = (math.log(at[side]) if at["log"] else at[side] for side in ("lower", "upper"))
    for times, caught in ((0.99, False), (1.01, True)):
        new = copy.deepcopy(old)
        moved = high + times * FAR * math.sqrt(2.0) * at["error"][1] * 0.5 * (high - low)
        new["endpoints"][name]["upper"] = math.exp(moved) if at["log"] else moved
        found = differences(old, new)
        assert bool(found) == caught
        assert all(text.startswith(f"{name}, upper") for text in found)


def test_numbers_that_come_or_go_are_named():
    old = frozen("published")
    new = copy.deepcopy(old)
    del new["exact"]["coupling margin"]
    new["curves"]["corner X"] = new["curves"].pop("corner VE1 mean normal marginal")
    new["exact"]["coupling verdict"] = "stable"
    assert sorted(differences(old, new)) == [
        "corner VE1 mean normal marginal: gone",
        "corner X: new",
        "coupling margin: gone",
        "coupling verdict: was 'unstable', is 'stable'",
    ]
