"""The first screen: each sentence and each number against the rest of the results."""

from __future__ import annotations

import dataclasses

import pytest

from percept.boundary.feels_real import judge
from percept.report.basics import Estimated, digits_of
from percept.report.biases import biases_of
from percept.report.decisions import doubtful_verdicts, feeling_sentences
from percept.report.overview import cautions, decide, findings, misfits, setting_sentences
from percept.results import (
    Checks,
    Confidences,
    DeviceStability,
    IntervalRow,
    Leaning,
    LeftOut,
    MethodPair,
    MoreSubjects,
    Note,
    PosteriorEvidence,
    PredictiveCheck,
    Rendered,
    Verdict,
    Words,
)
from tests.documents import EMPTY


def results(rows, *, verdicts=(), coupling=None, references=(10.0,)):
    """Results of intervals (environment, mean lower, estimate, upper, user lower, upper) around
    10."""
    intervals = [
        IntervalRow(
            environment=name,
            parameter="k",
            unit="N/m",
            reference=references[index % len(references)],
            joint="marginal",
            method="classical",
            family="lognormal",
            kind=kind,
            lower=lower,
            upper=upper,
            estimate=estimate,
            level=0.99,
            share=None,
            confidence=None,
            n=10,
            covers="",
        )
        for index, (name, low, estimate, high, user_low, user_high) in enumerate(rows)
        for kind, lower, upper in (("mean", low, high), ("user", user_low, user_high))
    ]
    return dataclasses.replace(
        EMPTY, intervals=tuple(intervals), verdicts=tuple(verdicts), coupling=coupling
    )


def felt(name, probability, classical=None, *, coupled=True, decision=0.95, straddles=False):
    """Return the verdict on an environment by a posterior probability and a classical
    confidence."""
    outcome = judge(probability, decision)
    other = classical and Confidences(
        outcome=judge(classical, decision), family="lognormal", probability=classical,
        stiffness=classical, damping=1.0, magnitude=None, magnitude_omega=None, together=None,
        together_error=None,
    )  # fmt: skip
    evidence = PosteriorEvidence(
        outcome=outcome, probability=probability, error=0.004, draws=4096, straddles=straddles,
        magnitude=probability, plane=1.0, by_central=(), lowest_omega=1.0,
    )  # fmt: skip
    return Verdict(
        environment=name, coupled=coupled, outcome=outcome, method="bayesian", stable_and_real=None,
        probability=probability, central=0.99, subjects=10, decision=decision, classical=other,
        bayesian=evidence,
    )  # fmt: skip


def rendered(environment, verdict, *, coupled=False):
    """Return a row on what is rendered in time."""
    return Rendered(
        environment=environment, coupled=coupled, verdict=verdict, reason="", needed_damping=1.0,
        margin=1.0, binding_omega=1.0,
    )  # fmt: skip


SOFT, HARD, NONE = ("A", 12, 15, 18, 5, 40), ("B", 8, 8.7, 9.5, 6, 12), ("C", 9, 10.1, 11, 7, 14)
CLAIM = "(classical, 99 %)"


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (
            [SOFT, HARD, NONE],
            "above the reference in A (+50 %, +20 to +80 %) and below the reference in B (−13 %,"
            " −20 to −5 %)",
        ),
        (
            [NONE, ("D", 9, 10, 11, 8, 12)],
            "with no clear bias in any of 2 environments; the largest is that of C (+1 %, −10 to"
            " +10 %)",
        ),
        ([SOFT], "above the reference in A (+50 %, +20 to +80 %)"),
        ([NONE], "with no clear bias in C (+1 %, −10 to +10 %)"),
        (
            [SOFT, ("D", 1100, 2530, 4000, 5, 6)],
            "above the reference in A (+50 %, +20 to +80 %) and D (253 times, 110 times to 400"
            " times)",
        ),
    ],
)
def test_biases_are_said_where_the_interval_leaves_the_reference_out(rows, said):
    assert setting_sentences(results(rows))[0] == f"Users set stiffness {said} {CLAIM}."


def test_a_classical_interval_of_another_sign_is_said():
    made = results([("soft", 10.04, 11.7, 13.6, 5, 40)])
    mean, user = (dataclasses.replace(row, method="bayesian") for row in made.intervals)

    def said(lower):
        bayesian = (dataclasses.replace(mean, lower=lower, upper=13.7), user)
        both = dataclasses.replace(made, intervals=made.intervals + bayesian)
        text = setting_sentences(both)[0]
        assert text in findings(both).paragraph
        return text

    assert said(9.9) == (
        "Users set stiffness with no clear bias in soft (+17 %, −1 to +37 %) (Bayesian, 99 %). The"
        " classical interval excludes zero in soft (+0.4 to +36 %)."
    )
    assert "classical" not in said(10.1)
    # Of one sign too, where no value lies in both.
    assert said(13.65).endswith("The classical interval lies apart in soft (+0.4 to +36 %).")


def test_more_than_five_names_are_counted():
    rows = [(f"E{index}", 12, 15, 18, 5, 40) for index in range(6)]
    (said, *_) = setting_sentences(results([*rows, NONE]))
    assert said == (
        "Users set stiffness above the reference in 6 of 7 environments, from E0 (+50 %, +20 to"
        f" +80 %) to E5 (+50 %, +20 to +80 %) {CLAIM}."
    )
    wider = setting_sentences(results([*rows[:5], ("E5", 12, 16, 18, 5, 40)]))[0]
    assert "above the reference in all 6 environments, from E0 (+50 %" in wider
    assert "to E5 (+60 %" in wider


def judged(verdicts, rendering=()):
    """Results of verdicts and of what is rendered, in a study of walls."""
    words = Words("wall", "walls", "user", "users", "user", "users")
    return dataclasses.replace(
        results([]),
        data=dataclasses.replace(EMPTY.data, words=words),
        verdicts=tuple(verdicts),
        rendering=tuple(rendering),
    )


def feeling(*verdicts):
    """Return what is said of verdicts on what can be rendered."""
    return " ".join(feeling_sentences(judged(verdicts)))


def test_what_feels_real_is_said_through_the_coupling_with_probability():
    direct = felt("A", 0.2, coupled=False)
    verdicts = (direct, felt("A", 0.986), felt("B", 0.0), felt("C", 0.02), felt("D", 0.6))
    assert feeling(*verdicts) == (
        "A feels real (99 %); B and C do not feel real (< 1 % and 2 %); for D the data do not"
        " decide (60 %)."
    )
    assert feeling(direct) == "For A the data do not decide (20 %)."
    many = [felt(f"E{index}", 1.0 - 0.004 * index) for index in range(7)]
    assert feeling(*many).startswith("All 7 feel real (98 % to > 99 %)")


def test_rounding_puts_no_probability_on_the_other_side_of_the_decision():
    assert "or A the data do not decide (94.9 %)" in feeling(felt("A", 0.949))
    assert "the data do not decide (99 %)" in feeling(felt("A", 0.99, decision=0.999))


def test_a_device_that_may_not_render_is_told_first():
    over_devices = DeviceStability(probability=0.71, error=0.01, draws=4096)
    row = dataclasses.replace(rendered("A", "can", coupled=True), by_device=over_devices)
    surely = dataclasses.replace(over_devices, probability=0.99)
    other = dataclasses.replace(rendered("B", "can", coupled=True), by_device=surely)
    found = judged([felt("A", 0.99), felt("B", 0.99)])
    assert cautions(dataclasses.replace(found, rendering=(row, other))) == [
        "What is known of the device leaves open whether it renders A (71 %) through the coupling:"
        " in brackets is how probably it does. Above, the device is as the scene states it."
    ]


def test_an_error_that_reaches_over_a_threshold_is_said():
    assert doubtful_verdicts(judged([felt("A", 0.952, straddles=True)])) == [
        "The Monte Carlo error of A through the coupling (95.2 ± 0.4 %) still reaches over a"
        " threshold after 4096 draws."
    ]


def test_a_verdict_that_leans_on_a_doubtful_row_is_said_with_the_verdict_without_it():
    row = Note("k = 6400 of subject 'S9', where …", "w.csv", 27)
    leaning = Leaning(rows=(row,), without=felt("A", 0.98))
    found = judged([dataclasses.replace(felt("A", 0.6), leaning=leaning)])
    doubts = (row, Note("twice", "w.csv", 30))
    found = dataclasses.replace(found, data=dataclasses.replace(found.data, doubts=doubts))
    assert cautions(found) == [
        "The verdict on A leans on row 27 of w.csv. Without that row, A feels real (98 %).",
        "w.csv:30: twice.",
    ]
    unnamed = dataclasses.replace(row, file="", row=None)
    leaning = Leaning(rows=(unnamed,) * 2, without=None)
    (said,) = doubtful_verdicts(judged([dataclasses.replace(felt("A", 0.6), leaning=leaning)]))
    assert said.endswith("'S9', where …. Without those rows, there is no verdict.")


def test_both_methods_are_named_where_they_disagree():
    said = feeling(felt("A", 0.97, 0.9), felt("B", 0.99, 0.99))
    assert said.endswith(
        "That is the Bayesian answer; by the classical method, for A the data do not decide (90 %)."
    )
    assert "classical" not in feeling(felt("B", 0.99, 0.99))
    made = results([SOFT], verdicts=[felt("A", 0.97, 0.9)])
    assert "by the classical method, for A the data do not decide" in findings(made).paragraph


def test_what_cannot_be_rendered_is_never_said_to_feel_real():
    rows = [
        rendered(name, verdict, coupled=True) for name, verdict in (("A", "can"), ("B", "cannot"))
    ]
    verdicts = [felt("A", 0.98), felt("B", 0.99)]
    assert feeling_sentences(judged(verdicts, rows)) == [
        "Through this coupling, only A can be rendered with every hand.",
        "A feels real (98 %).",
    ]


@pytest.mark.parametrize(
    ("verdicts", "said"),
    [
        (("can", "can"), "Displayed directly, all 2 walls can be rendered with every hand."),
        (("can", "cannot"), "Displayed directly, only A can be rendered with every hand."),
        (
            ("cannot", "cannot"),
            "Displayed directly, none of 2 walls can be rendered with every hand.",
        ),
        (("cannot",), "Displayed directly, A cannot be rendered with every hand."),
        (
            ("can", "undecided"),
            "Displayed directly, only A can be rendered with every hand; for B the device’s table"
            " does not tell.",
        ),
        (
            ("undecided",),
            "Displayed directly, the device’s table does not tell what can be rendered.",
        ),
    ],
)
def test_what_can_be_rendered_in_time_is_said(verdicts, said):
    rows = [rendered(name, verdict) for name, verdict in zip("AB", verdicts, strict=False)]
    assert feeling_sentences(judged((), rows)) == [said]


def test_what_the_device_lacks_is_said_with_the_damping_that_is_needed():
    scene = {"inference": {"family": "lognormal"}, "device": {"damping": 0.5, "mass": 1.0}}
    made = dataclasses.replace(
        results([SOFT]),
        rendering=(rendered("A", "cannot"), rendered("B", "can")),
        provenance=dataclasses.replace(EMPTY.provenance, scene=scene),
    )
    assert decide(made) == [
        "Displayed directly, only B can be rendered with every hand.",
        "A would need a device with 1 N·s/m of damping; this one has 0.5.",
    ]


def test_without_a_device_the_next_user_s_range_is_said():
    said = setting_sentences(results([SOFT, HARD]))
    assert (
        said[-1]
        == "With 99 % confidence, the next user’s stiffness will be 0.6 to 1.2 times the reference"
        " in B, the narrowest range, and 0.5 to 4 times the reference in A, the widest."
    )


def test_narrow_ranges_of_the_next_user_are_told_apart():
    said = setting_sentences(results([("A", 9.98, 10, 10.02, 9.912, 10.034)]))[-1]
    assert said.endswith("stiffness will be 0.9912 to 1.0034 times the reference in A.")


@pytest.mark.parametrize(
    ("reference", "ends", "said", "user"),
    [
        (
            -6.0,
            (-8, -7.19, -6.5, -9, -5),
            "below the reference in A (−1.19 N/m, ",
            "−3 to +1 N/m off",
        ),
        (-6.0, (-5.5, -5, -4, -7, -1), "above the reference in A (+1 N/m, ", "−1 to +5 N/m off"),
        (0.0, (1, 2, 3, 0.5, 4), "above zero in A (+2 N/m, +1 to +3 N/m)", "+0.5 to +4 N/m in A."),
    ],
)
def test_zero_and_negative_references_are_compared_by_differences(reference, ends, said, user):
    made = results([("A", *ends)], references=(reference,))
    first_said, next_user = setting_sentences(made)
    assert first_said.startswith(f"Users set stiffness {said}")
    assert f"will be {user}" in next_user
    (bias,) = biases_of(made)
    assert bias.relative is False
    assert bias.estimate == pytest.approx(ends[1] - reference)
    assert bias.lower < bias.estimate < bias.upper


def test_one_zero_reference_puts_the_whole_quantity_in_its_unit():
    made = results([SOFT, ("D", 9, 11, 13, 5, 20)], references=(10.0, 0.0))
    assert [bias.relative for bias in biases_of(made)] == [False, False]
    assert setting_sentences(made)[0] == (
        "Users set stiffness above the reference in A (+5 N/m, +2 to +8 N/m) and D (+11 N/m, +9 to"
        f" +13 N/m) {CLAIM}."
    )


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
    assert digits_of(Estimated(value, *limits)) == digits


@pytest.mark.parametrize(
    ("counts", "said"),
    [
        ([9], "To decide W0, about 9 more users."),
        ([162, 14], "To decide W0 and W1, about 160 and 14 more users."),
        (
            [None, 1],
            "To decide W1, about 1 more user. W0 would take more than 1,000 users.",
        ),
        ([9, 34, 3, 4, 5, 6], "To decide 6 walls, about 3 to 34 more users."),
    ],
)
def test_an_undecided_verdict_says_how_many_more_subjects_decide(counts, said):
    verdicts = []
    for index, count in enumerate(counts):
        more = MoreSubjects(subjects=count, assurance=0.8, most=1000)
        undecided = felt(f"W{index}", 0.5, 0.5)
        verdicts.append(dataclasses.replace(undecided, more=more))
    assert said in feeling(*verdicts)


def test_intervals_too_wide_to_read_are_not_written_out():
    useless = setting_sentences(results([("A", 1e-6, 12.0, 1e12, 1e-9, 1e15)]))[0]
    assert useless == f"Stiffness: these subjects are too few to say anything {CLAIM}."
    readable = setting_sentences(results([("A", 1.0, 12.0, 900.0, 0.5, 1e3)]))[0]
    assert "in A (+20 %, −90 % to 90 times)" in readable


def test_what_the_data_do_not_determine_is_said_without_its_numbers():
    wide = ("wide", 1e-3, 12.0, 1e5, 1e-6, 1e8)
    said = setting_sentences(results([SOFT, HARD, wide]))[-1]
    assert said.endswith(
        " to 4 times the reference in A, the widest. These data do not determine the next user’s"
        " stiffness in wide."
    )
    of_two = setting_sentences(results([SOFT, wide]))[-1]
    assert "will be 0.5 to 4 times the reference in A. These data do not" in of_two
    alone = setting_sentences(results([wide]))[-1]
    assert alone == "These data do not determine the next user’s stiffness in wide."


def test_where_nothing_was_matched_sentences_give_means():
    found = results([("A", 1, 2, 3, -0.5, 4), ("B", 5, 6, 7, 4, 8)], references=(0.0, 0.0))
    quantities = {
        name: quantity.model_copy(update={"reference": "none"})
        for name, quantity in found.data.quantities.items()
    }
    data = dataclasses.replace(found.data, quantities=quantities)
    said = setting_sentences(dataclasses.replace(found, data=data))
    assert said == [
        "Mean stiffness by environment: A (2 N/m, 1 to 3 N/m) and B (6 N/m, 5 to 7 N/m)"
        " (classical, 99 %).",
        "With 99 % confidence, the next user’s stiffness will be 4 to 8 N/m in B, the narrowest"
        " range, and −0.5 to 4 N/m in A, the widest.",
    ]


@pytest.mark.parametrize(("reach", "said"), [(1.4, []), (2.0, ["2 times as wide"])])
def test_an_interval_that_the_prior_widens_is_told(reach, said):
    found = results([("A", 5, 6, 7, 4, 8)])
    scene = {**found.provenance.scene, "inference": {"family": "normal"}}
    provenance = dataclasses.replace(found.provenance, scene=scene)
    pair = MethodPair(
        environment="A", parameter="k", kind="mean", family="normal", width_ratio=reach,
        relative=True, shift=0.0,
    )  # fmt: skip
    widened = dataclasses.replace(found, comparison=(pair,), provenance=provenance)
    told = [one for one in cautions(widened) if "times as wide" in one]
    assert len(told) == len(said)
    assert all(text in one for text, one in zip(said, told, strict=True))


@pytest.mark.parametrize(
    ("statistic", "above", "text"),
    [
        ("farthest", 0.999, "In VE2 the subjects lie closer together in b than the model expects"),
        ("farthest", 0.001, "In VE2 one subject lies farther from the others in b than the model"),
        ("sd", 0.999, "In VE2 subjects differ less in b than the model expects (1 of 2 checks)."),
        ("mean", 0.001, "In VE2 the mean of b is higher than the model expects (1 of 2 checks)."),
    ],
)
def test_a_check_that_fails_says_on_which_side(statistic, above, text):
    usual = PredictiveCheck("VE1", "b", statistic, 0.5, unusual=False)
    unusual = PredictiveCheck("VE2", "b", statistic, above, unusual=True)
    left_out = LeftOut(0.7, subjects=(), cells=(), messages=())
    checks = Checks(normality=(), loo=left_out, statistics=(usual, unusual))
    said = list(misfits(dataclasses.replace(EMPTY, checks=checks)))
    assert any(sentence.startswith(text) for sentence in said)
