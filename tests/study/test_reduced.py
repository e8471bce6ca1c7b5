"""Studies reduced while they are read: the model and the intervals of the trials themselves."""

from __future__ import annotations

import numpy as np
import pytest

from percept import Study, read_sessions
from percept.errors import RefusalError, UsageError
from percept.scene import Scene
from percept.sessions import reduce_sessions
from percept.study.fit import prepare
from percept.study.reduced import prepare_reduced, reduced_intervals
from tests.unmixed import UNMIXED, unmixed_sessions

HEAD = "subject,environment,k_ref,b_ref,trial,k_adj,b_adj"
PLACES = {"VE1": (15.0, 0.7), "VE2": (1000.0, 1.5), "VE3": (50000.0, 100.0)}


def study(file, *, missing=(), subjects=6, most=4, edit=None):
    rng = np.random.default_rng(7)
    rows = []
    for s in range(subjects):
        of_subject = 0.1 * rng.standard_normal(2)
        for j, (place, (k, b)) in enumerate(PLACES.items()):
            if (s, j) in missing:
                continue
            of_cell = of_subject + 0.15 * rng.standard_normal(2)
            for trial in range(1 + (s + j) % most):
                noise = 0.05 * rng.standard_normal(2)
                k_adj, b_adj = np.array([k, b]) * np.exp(of_cell + noise)
                rows.append([s, place, k, b, trial, repr(float(k_adj)), repr(float(b_adj))])
    if edit:
        edit(rows)
    file.write_text("\n".join([HEAD, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return file


def scene(**inference):
    return Scene().with_inference(**inference)


@pytest.mark.parametrize("family", ["lognormal", "normal"])
@pytest.mark.parametrize("most", [1, 4])
def test_the_density_is_that_of_the_trials(tmp_path, family, most):
    file = study(tmp_path / "s.csv", missing={(0, 1), (3, 2), (4, 0), (4, 1)}, most=most)
    asked = scene(family=family)
    ours = prepare_reduced(reduce_sessions(file, family=family), asked)
    theirs = prepare(read_sessions(file), asked, ("k", "b"))
    assert ours.model.names == theirs.model.names
    assert ours.model.cells == theirs.model.cells
    np.testing.assert_array_equal(ours.counts, theirs.counts)
    points = np.random.default_rng(1).standard_normal((40, len(ours.model.names)))
    np.testing.assert_allclose(ours.model(points), theirs.model(points), rtol=1e-11, atol=1e-10)


@pytest.mark.parametrize("parameters", [("k",), ("b",), ("b", "k")])
def test_the_parameters_asked_for_and_their_order(tmp_path, parameters):
    file = study(tmp_path / "s.csv")
    asked = scene(parameters=parameters)
    ours = prepare_reduced(reduce_sessions(file), asked)
    theirs = prepare(read_sessions(file), asked, Study(read_sessions(file), asked).parameters)
    points = np.random.default_rng(2).standard_normal((10, len(ours.model.names)))
    assert ours.model.cells == theirs.model.cells
    np.testing.assert_allclose(ours.model(points), theirs.model(points), rtol=1e-11, atol=1e-10)


def test_intervals_are_those_of_the_trials(tmp_path):
    file = study(tmp_path / "s.csv")
    asked = scene(tolerance=0.3, seed=3, parameters=("k",))
    ours = reduced_intervals(reduce_sessions(file), asked)
    theirs = Study(read_sessions(file), asked).intervals
    theirs = theirs[
        (theirs["method"] == "bayesian") | (theirs["family"] == "lognormal")
    ].reset_index(drop=True)
    same = [c for c in theirs if c not in ("lower", "upper", "estimate")]
    assert ours[same].equals(theirs[same])
    classical = (theirs["method"] == "classical").to_numpy()
    assert classical.sum() == (~classical).sum() > 0
    numbers = ["lower", "upper", "estimate"]
    np.testing.assert_allclose(ours[numbers][classical], theirs[numbers][classical], rtol=1e-12)
    # The same seed leads through the same draws.
    half = 0.5 * (theirs["upper"] - theirs["lower"])[~classical]
    for name in numbers:
        apart = (ours[name] - theirs[name])[~classical] / half
        assert np.abs(apart).max() < 1e-6


def test_without_one_method(tmp_path):
    reduced = reduce_sessions(study(tmp_path / "s.csv"))
    assert set(reduced_intervals(reduced, scene(method="classical"))["method"]) == {"classical"}
    asked = scene(method="bayesian", tolerance=0.5, parameters=("k",))
    assert set(reduced_intervals(reduced, asked)["method"]) == {"bayesian"}


def test_rows_that_lack_a_parameter_are_left_out(tmp_path):
    def lose(rows):
        rows[0][6] = ""
        for row in rows:
            if row[0] == 5 and row[1] == "VE2":
                row[5] = ""

    file = study(tmp_path / "s.csv", edit=lose)
    asked = scene()
    ours = prepare_reduced(reduce_sessions(file), asked)
    theirs = prepare(read_sessions(file), asked, ("k", "b"))
    np.testing.assert_array_equal(ours.counts, theirs.counts)
    points = np.random.default_rng(4).standard_normal((10, len(ours.model.names)))
    np.testing.assert_allclose(ours.model(points), theirs.model(points), rtol=1e-11, atol=1e-10)


def test_what_cannot_be_done_is_said(tmp_path):
    reduced = reduce_sessions(study(tmp_path / "s.csv"))
    with pytest.raises(
        UsageError, match=r"inference\.family.*reduced to .* the family 'lognormal'"
    ):
        reduced_intervals(reduced, scene(family="normal"))
    unpooled = Scene(model={"pooling": "none", "prior": "reference"})
    with pytest.raises(UsageError, match=r"model\.pooling.*cells that were reduced are pooled"):
        reduced_intervals(reduced, unpooled)
    lone = reduce_sessions(study(tmp_path / "lone.csv", subjects=1))
    with pytest.raises(RefusalError, match="at least two subjects"):
        prepare_reduced(lone, scene())
    only_k = tmp_path / "k.csv"
    only_k.write_text(
        "subject,environment,k_ref,trial,k_adj\nA,VE1,15,1,14\nB,VE1,15,1,16\nC,VE1,15,1,15.5\n"
    )
    with pytest.raises(RefusalError, match="asks for damping, which no session has"):
        reduced_intervals(reduce_sessions(only_k), scene(parameters=("b",)))


@pytest.mark.parametrize("method", ["classical", "bayesian"])
def test_one_subject_is_refused_by_either_method(tmp_path, method):
    lone = reduce_sessions(study(tmp_path / "lone.csv", subjects=1))
    with pytest.raises(RefusalError, match="at least two subjects"):
        reduced_intervals(lone, scene(method=method))


def test_nothing_but_equal_values_is_refused(tmp_path):
    rows = [f"S{s},VE1,15,1,15.5" for s in range(4)]
    (tmp_path / "same.csv").write_text(
        "\n".join(["subject,environment,k_ref,trial,k_adj", *rows]) + "\n"
    )
    reduced = reduce_sessions(tmp_path / "same.csv")
    with pytest.raises(
        RefusalError, match=r"no interval of anything: stiffness in VE1, .* adjusted alike"
    ):
        reduced_intervals(reduced, scene(method="classical"))


def test_a_failed_gate_is_told(tmp_path):
    unmixed_sessions().to_csv(tmp_path / "s.csv", index=False)
    reduced = reduce_sessions(tmp_path / "s.csv")
    both = reduced_intervals(reduced, scene(**UNMIXED))
    assert set(both["method"]) == {"classical"}
    ((what, why),) = both.attrs["skipped"]
    assert what == "Bayesian intervals"
    assert "autocorrelation times" in why
    with pytest.raises(
        RefusalError, match=r"the Bayesian intervals are withheld: .*autocorrelation times"
    ):
        reduced_intervals(reduced, scene(method="bayesian", **UNMIXED))


def test_an_error_above_the_tolerance_is_told_beside_the_intervals(tmp_path):
    reduced = reduce_sessions(study(tmp_path / "s.csv", most=1))
    asked = scene(method="bayesian", tolerance=0.001, most_steps=400, walkers=64, parameters=("k",))
    found = reduced_intervals(reduced, asked)
    assert set(found["method"]) == {"bayesian"}
    assert "and 0.1 % was requested" in found.attrs["error_reached"]
    assert reduced_intervals(reduced, scene(method="classical")).attrs["error_reached"] == ""
