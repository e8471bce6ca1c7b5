"""Sufficient statistics against direct formulas, and what they must not depend on."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from percept.inference.model.design import Options
from percept.inference.model.model import plain_model
from percept.inference.model.statistics import from_summary, from_trials
from tests.inference.model.designs import made

#: Designs without factors.
PLAIN = ("plain", "one quantity", "plain, unequal trials", "plain, missing cells", "two subjects",
         "one cell, unequal trials")  # fmt: skip


def reduce(built, order=slice(None), shift=0.0, relabel=None):
    """Statistics of the trials in another order, moved, or of subjects numbered otherwise."""
    study, statistics = built.study, built.model.statistics
    subject = study.subject if relabel is None else relabel[study.subject]
    return from_trials(
        study.response[order] + shift,
        subject[order],
        study.cell[order],
        study.x,
        parameters=statistics.parameters,
        environments=statistics.environments,
        subjects=statistics.subjects,
    )


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(PLAIN), st.integers(0, 2**31))
def test_order_of_rows_and_names_of_subjects_do_not_matter(name, seed):
    rng = np.random.default_rng(seed)
    study = made(name, seed)
    order = rng.permutation(len(study.study.subject))
    relabel = rng.permutation(len(study.model.statistics.subjects))
    points = rng.normal(size=(4, len(study.model.names)))
    values = study.model(points)
    for statistics in (reduce(study, order), reduce(study, relabel=relabel)):
        np.testing.assert_allclose(plain_model(statistics)(points), values, rtol=1e-11)


@pytest.mark.parametrize("name", ["plain, trials", "plain, missing cells"])
def test_scatter_survives_a_common_offset(name):
    study = made(name)
    shift = 2.0**30  # exact in doubles beside values rounded to 2^-20
    study.study.response[:] = np.round(study.study.response * 2.0**20) / 2.0**20
    near, far = reduce(study), reduce(study, shift=shift)
    # A mean of three such trials is itself rounded, by up to 2^-24.
    atol = 0.0 if name == "plain, missing cells" else 2.0**-22
    np.testing.assert_allclose(far.sd, near.sd, rtol=1e-11, atol=atol)
    rows = [np.abs(statistics.scatter.rows) for statistics in (far, near)]
    np.testing.assert_allclose(*rows, rtol=0, atol=atol)


@pytest.mark.parametrize("value", [0.1, -0.3, 1.7, 1e9 / 3])
@pytest.mark.parametrize("subjects", [3, 7, 10])
def test_equal_values_have_no_scatter_at_all(value, subjects):
    """The refusal of a cell without scatter rests on an exact zero."""
    statistics = from_trials(
        np.full((3 * subjects, 1), value),
        np.repeat(np.arange(subjects), 3),
        np.zeros(3 * subjects, dtype=int),
        np.zeros((1, 1)),
        parameters=("k",),
        environments=("VE1",),
        subjects=tuple(f"S{i}" for i in range(subjects)),
    )
    assert statistics.sd[0, 0] == 0.0
    assert not statistics.scatter.rows.any()


def test_summary_is_the_likelihood_of_means_and_sds():
    """y-bar ~ N(beta, sigma²/n) and nu s²/sigma² ~ chi-square: the density of trials less a
    constant."""
    rng = np.random.default_rng(9)
    subjects, environments = 7, 4
    response = 0.2 * rng.normal(size=(subjects, environments))
    x = np.array([[-1.0, 0.0, 0.4, 0.6]])
    labels = tuple("ABCD")
    summary = from_summary(
        response.mean(axis=0),
        response.std(axis=0, ddof=1),
        np.full(4, subjects),
        x[0],
        parameter="k",
        environments=labels,
    )
    i, j = np.indices(response.shape).reshape(2, -1)
    trials = from_trials(
        response.reshape(-1, 1),
        i,
        j,
        x,
        parameters=("k",),
        environments=labels,
        subjects=tuple("1234567"),
    )
    ours = plain_model(summary)
    other = plain_model(trials, options=Options(subject_effect=False))
    assert ours.names == other.names
    points = rng.normal(size=(20, len(ours.names)))
    difference = ours(points) - other(points)
    np.testing.assert_allclose(difference, difference[0], rtol=1e-11, atol=1e-11)
