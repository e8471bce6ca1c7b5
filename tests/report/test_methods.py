"""The methods paragraph names the model that was fitted, whatever data and scene leave out of it."""

from __future__ import annotations

import pytest

from percept.report.sections.methods import build

REGRESSION = "a regression of bias on the logarithm of the reference with a deviation for each environment"
SHARED = "subject effects shared by all environments"
PAIR = " and correlated between stiffness and damping"
WITHIN = "between-subject scatter within each environment"


def model_of(*, form="trials", environments=3, parameters=("k", "b"), **model):
    rows = [
        {"parameter": p, "kind": "mean", "method": "bayesian", "family": "lognormal", "n": 6}
        for p in parameters
    ]
    document = {
        "data": {
            "form": form,
            "parameters": [*parameters],
            "environments": [f"VE{j}" for j in range(environments)],
        },
        "provenance": {
            "scene": {"inference": {"family": "lognormal"}, "model": model},
            "versions": {"percept": "0"},
        },
        "intervals": rows,
        "diagnostics": None,
        "coupling": None,
        "band": None,
        "boundaries": [],
    }
    return build(document).values["model"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, f"{REGRESSION}, {SHARED}{PAIR}, and {WITHIN}"),
        ({"parameters": ("k",)}, f"{REGRESSION}, {SHARED}, and {WITHIN}"),
        ({"environments": 1}, "a bias, and between-subject scatter"),
        ({"form": "summary"}, f"{REGRESSION}, and {WITHIN} (stiffness and damping each by itself)"),
        ({"subject_effect": False}, f"{REGRESSION}, and {WITHIN}"),
        (
            {"common_spread": True},
            f"{REGRESSION}, {SHARED}{PAIR}, and between-subject scatter alike in all environments",
        ),
        (
            {"weber": True, "parameters": ("b",)},
            f"{REGRESSION}, {SHARED}, and {WITHIN}, "
            "in proportion to the reference but for each environment’s own deviation",
        ),
    ],
)
def test_the_model_that_was_fitted_is_named(given, said):
    assert model_of(**given) == said
