"""Twelve studies give the numbers that they gave when these were frozen."""

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
BAYESIAN = ("one_parameter", "one_environment", "stools")


def now_of(golden, classical, document):
    return json.loads(json.dumps(frozen_part(golden, classical, document)))


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("golden", STUDIES, ids=lambda golden: golden.name)
def test_numbers_are_as_frozen(golden):
    """`make test` takes the Bayesian numbers of three, and the classical ones of eleven."""
    if golden.name == "repeats" and not LONG:
        pytest.skip("takes seconds: run `make evidence`")
    old = frozen(golden.name)
    assert len(old["exact"]) > 30
    classical = golden.report(method="classical")
    if LONG or golden.name in BAYESIAN:
        now = now_of(golden, classical, golden.report())
        assert now["skipped"] == old["skipped"]
    else:
        now = now_of(golden, classical, classical)
        old = {**old, "endpoints": {}, "estimates": {}}
    assert differences(old, now) == []


@pytest.mark.parametrize(
    ("part", "name", "tolerance"),
    [
        ("exact", "intervals[VE1 k mean classical normal marginal]", EXACT),
        ("exact", "coupling.eq10_margin", EXACT),
        ("exact", "sensitivity.verdicts[VE1 2]", POINTWISE),
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
    return value * factor if isinstance(value, float) else value


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
    del new["exact"]["coupling.eq10_margin"]
    new["curves"]["corner X"] = new["curves"].pop("corner VE1 mean normal marginal")
    new["exact"]["coupling.eq10"] = "met"
    assert sorted(differences(old, new)) == [
        "corner VE1 mean normal marginal: gone",
        "corner X: new",
        "coupling.eq10: was 'not met', is 'met'",
        "coupling.eq10_margin: gone",
    ]
