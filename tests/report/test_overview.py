"""The first screen: each sentence and each number against the rest of the document."""

from __future__ import annotations

import copy

import pytest

from percept.report.overview import digits_of, overview
from percept.report.select import first, matching


def document(rows, *, realism=(), coupling=None):
    """A document of intervals (environment, mean lower, estimate, upper, user lower, upper) around 10."""
    intervals = [
        {
            "environment": name, "parameter": "k", "unit": "N/m", "reference": 10.0, "joint": "marginal",
            "method": "classical", "family": "lognormal", "kind": kind,
            "lower": lower, "upper": upper, "estimate": estimate, "level": 0.99,
        }
        for name, low, estimate, high, user_low, user_high in rows
        for kind, lower, upper in (("mean", low, high), ("user", user_low, user_high))
    ]  # fmt: skip
    found = (
        None if coupling is None and not realism else {"realism": list(realism), **(coupling or {})}
    )
    words = {name: [name, f"{name}s"] for name in ("environment", "subject", "user")}
    quantities = {"k": {"name": "k", "label": "stiffness", "symbol": "k", "unit": "N/m"}}
    return {
        "intervals": intervals,
        "coupling": found,
        "provenance": {"scene": {}},
        "data": {"quantities": quantities, "words": words},
    }


def felt(name, verdict, departure=0.1, **other):
    """Return what the document says of a reference, with one verdict directly and through the coupling."""
    labels = {"environment": name, "kind": "user", "shape": "envelope", "joint": "marginal"}
    row = labels | {"method": "classical", "family": "lognormal"}
    for side in ("uncoupled", "coupled"):
        row |= {
            f"verdict_{side}": verdict,
            f"departure_{side}": departure,
            f"departure_omega_{side}": 31.6,
            f"plane_departure_{side}": -0.2,
        }
    return row | other


STABLE = {"margin": 1.4, "verdict": "stable"}
SOFT, HARD, NONE = ("A", 12, 15, 18, 5, 40), ("B", 8, 8.7, 9.5, 6, 12), ("C", 9, 10.1, 11, 7, 14)


def test_biases_are_said_where_the_interval_leaves_the_reference_out():
    said = overview(document([SOFT, HARD, NONE]))["sentences"]
    assert said[0] == "Stiffness is 50 % too high in A, and 13 % too low in B."
    assert (
        overview(document([NONE, ("D", 9, 10, 11, 8, 12)]))["sentences"][0]
        == "Stiffness shows no clear bias in any of 2 environments."
    )
    assert overview(document([SOFT]))["sentences"][0] == "Stiffness is 50 % too high."
    twice = overview(document([SOFT, ("D", 1100, 2530, 4000, 5, 6)]))["sentences"][0]
    assert twice == "Stiffness is too high in A and D, by 50 % (A) to 253 times (D)."


def test_more_than_five_names_are_counted():
    rows = [(f"E{index}", 12, 15, 18, 5, 40) for index in range(6)] + [NONE]
    (said, *_) = overview(document(rows))["sentences"]
    assert said == "Stiffness is 50 % too high in 6 of 7 environments."
    wider = overview(document([*rows[:5], ("E5", 12, 16, 18, 5, 40)]))["sentences"][0]
    assert wider == "Stiffness is too high in all 6 environments, by 50 (E0) to 60 % (E5)."


def test_what_feels_real_is_said_through_the_coupling():
    margin = {"margin": 0.3157, "verdict": "unstable"}
    realism = [felt("A", "inside"), felt("B", "outside"), felt("C", "outside", departure=0.58)]
    said = overview(document([SOFT], realism=realism, coupling=margin))["sentences"]
    assert (
        said[1]
        == "Through the coupling, A stays inside the next user’s boundary; B and C leave it by up"
        " to 58 %."
    )
    assert (
        said[2]
        == "The coupling is unstable: the device has 32 % of the damping the coupling needs."
    )
    touching = [felt("B", "outside", departure=14.2), felt("C", "marginal")]
    assert (
        overview(document([SOFT], realism=touching, coupling=margin))["sentences"][1]
        == "Through the coupling, C touches the limits of the next user’s boundary; "
        "B leaves it by up to 15.2 times."
    )
    stable = overview(document([SOFT], coupling={"margin": 1.4, "verdict": "stable"}))["sentences"]
    assert (
        "The coupling is stable: the device has 1.4 times the damping the coupling needs." in stable
    )
    reason = "A measured device's poles cannot be checked."
    measured = overview(
        document([SOFT], coupling={"margin": 1.4, "verdict": "stable", "reason": reason})
    )
    assert measured["sentences"][1].endswith(
        "needs. The device is measured, so its poles cannot be checked."
    )


def test_without_a_device_the_next_user_s_range_is_said():
    said = overview(document([SOFT, HARD]))["sentences"]
    assert (
        said[-1]
        == "With 99 % confidence, the next user’s stiffness will be 0.6 to 1.2 times the reference"
        " (B, the narrowest) and 0.5 to 4 times the reference (A, the widest)."
    )


def test_a_departure_is_the_fraction_by_which_the_boundary_is_left():
    found = overview(
        document([SOFT], realism=[felt("A", "outside", departure=0.58)], coupling=STABLE)
    )
    assert found["realism"][0]["directly"] == {
        "verdict": "outside", "departure": 0.58, "omega": 31.6,
        "plane_departure": -0.2,
    }  # fmt: skip
    inside = overview(
        document([SOFT], realism=[felt("A", "inside", departure=-0.2)], coupling=STABLE)
    )
    assert inside["realism"][0]["directly"]["departure"] == 0.0


@pytest.mark.parametrize(
    ("stability", "row", "breaks"),
    [
        ("stable", {}, []),
        ("stable", {"verdict_coupled": "marginal", "plane_departure_coupled": 0.0}, []),
        ("marginal", {}, ["stability"]),
        ("unstable", {"plane_departure_coupled": 0.1}, ["stability", "plane"]),
        ("stable", {"verdict_coupled": "outside"}, ["magnitude"]),
    ],
)
def test_what_the_scene_s_coupling_breaks_is_named(stability, row, breaks):
    coupling = {"margin": 1.4, "verdict": stability}
    (found,) = overview(document([SOFT], realism=[felt("A", "inside", **row)], coupling=coupling))[
        "realism"
    ]
    assert found["breaks"] == breaks


def test_the_bias_from_a_reference_of_zero_is_in_units():
    made = document([SOFT])
    for row in made["intervals"]:
        row["reference"] = 0.0
    found = overview(made)
    (row,) = found["rows"]
    assert row["user_upper_ratio"] is None
    assert row["estimate"] == row["bias"] == 15
    assert (row["bias_lower"], row["bias_upper"]) == (12, 18)
    assert found["sentences"][0] == "Stiffness is 15 N/m too high."


def test_narrow_ranges_of_the_next_user_are_told_apart():
    said = overview(document([("A", 9.98, 10, 10.02, 9.912, 10.034)]))["sentences"][-1]
    assert said.endswith("the next user’s stiffness will be 0.9912 to 1.003 times the reference.")


@pytest.mark.parametrize(
    ("reference", "ends", "said", "user"),
    [
        (-6.0, (-8, -7.19, -6.5, -9, -5), "1.2 N/m too low", "3 N/m below and 1 N/m above"),
        (-6.0, (-5.5, -5, -4, -7, -1), "1 N/m too high", "1 N/m below and 5 N/m above"),
        (-6.0, (-8, -7.19, -6.5, -9, -6.5), "1.2 N/m too low", "0.5 to 3 N/m below"),
        (0.0, (1, 2, 3, 0.5, 4), "2 N/m too high", "0.5 to 4 N/m above"),
    ],
)
def test_zero_and_negative_references_are_compared_by_differences(reference, ends, said, user):
    made = document([("A", *ends)])
    for row in made["intervals"]:
        row["reference"] = reference
    found = overview(made)
    assert found["sentences"][0] == f"Stiffness is {said}."
    assert f"{user} the reference" in found["sentences"][1]
    (row,) = found["rows"]
    assert row["relative"] is False
    assert row["bias"] == pytest.approx(ends[1] - reference)
    assert row["bias_lower"] < row["bias"] < row["bias_upper"]
    assert row["user_lower_ratio"] is None


def test_one_zero_reference_puts_the_whole_quantity_in_its_unit():
    made = document([SOFT, ("D", 9, 11, 13, 5, 20)])
    for row in made["intervals"]:
        row["reference"] = 0.0 if row["environment"] == "D" else 10.0
    found = overview(made)
    assert [row["relative"] for row in found["rows"]] == [False, False]
    assert found["sentences"][0] == "Stiffness is too high in A and D, by 5 (A) to 11 N/m (D)."


def test_rows_are_the_bayesian_intervals_of_the_study_s_family(both):
    shown = both["summary"]["overview"]
    assert len(shown["rows"]) == 2 * 3
    for row in shown["rows"]:
        alike = matching(
            both["intervals"], joint="marginal", method="bayesian", family="lognormal",
            environment=row["environment"], parameter=row["parameter"],
        )  # fmt: skip
        mean, user = (first(matching(alike, kind=kind)) for kind in ("mean", "user"))
        assert row["estimate"] == mean["estimate"]
        assert row["bias"] == mean["estimate"] / mean["reference"] - 1
        assert (row["bias_lower"], row["bias_upper"]) == (
            mean["lower"] / mean["reference"] - 1,
            mean["upper"] / mean["reference"] - 1,
        )
        assert (row["user_lower"], row["user_upper"]) == (user["lower"], user["upper"])


def test_a_withheld_fit_leaves_the_classical_numbers(both):
    made = copy.deepcopy(both)
    made["intervals"] = matching(made["intervals"], method="classical")
    assert {row["method"] for row in overview(made)["rows"]} == {"classical"}


@pytest.mark.parametrize(
    ("value", "limits", "digits"),
    [
        (13.8, (6.0, 30.0), 3),
        (983.0, (833.0, 1160.0), 3),
        (43500.0, (43400.0, 43600.0), 5),
        (0.0, (0.0, 1.0), 4),
    ],
)
def test_digits_end_near_a_hundredth_of_the_half_width(value, limits, digits):
    assert digits_of(value, *limits) == digits
