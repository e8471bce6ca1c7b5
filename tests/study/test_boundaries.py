"""Boundaries of every kind, method and shape, also where an impedance is endless."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study, UsageError, read_sessions
from percept.haptics.perceived import perceived_magnitude
from percept.results import Boundary
from percept.sessions import Sessions
from tests import DATASETS
from tests.study.checked import table_of


def keys(study: Study) -> set[tuple[str, str, str, str]]:
    return {(b.method, b.kind, b.joint, b.shape) for b in study.boundaries_of(("VE3",))}


def test_every_kind_method_and_joint_treatment_has_its_boundaries(fitted: Study) -> None:
    found = keys(fitted)
    for method in ("classical", "bayesian"):
        for kind in ("mean", "user", "share"):
            for joint in ("marginal", "bonferroni"):
                assert {(method, kind, joint, "corner"), (method, kind, joint, "envelope")} <= found
        for kind in ("mean", "user"):
            assert (method, kind, "hotelling", "envelope") in found
            assert (method, kind, "joint", "pointwise") in found
    assert not any(
        kind == "share" and joint in ("hotelling", "joint") for _, kind, joint, _ in found
    )
    assert {shape for *_, shape in found} == {"corner", "envelope", "pointwise", "simultaneous"}
    assert "simultaneous bands through draws" not in {part.what for part in fitted.skipped_rows}


def test_all_curves_of_an_environment_stand_at_the_same_frequencies(fitted: Study) -> None:
    for environment in fitted.data.environments:
        grids = [b.omega for b in fitted.boundaries if b.environment == environment]
        assert all(np.array_equal(grid, grids[0]) for grid in grids)
        assert grids[0][[0, -1]] == pytest.approx([0.1, 100.0])


def bands(study: Study, shape: str) -> dict[tuple[str, ...], Boundary]:
    return {
        (b.environment, b.kind, b.method, b.family): b for b in study.boundaries if b.shape == shape
    }


def test_simultaneous_bands_contain_the_pointwise_ones(fitted: Study) -> None:
    point, together = bands(fitted, "pointwise"), bands(fitted, "simultaneous")
    assert point.keys() == together.keys()
    for key, band in together.items():
        assert (band.lower <= point[key].lower).all()
        assert (band.upper >= point[key].upper).all()
        if band.method == "classical":
            assert band.error is None
        else:
            assert (band.lower > 0.0).all()


def test_posterior_draws_lie_inside_pointwise_and_simultaneous_limits_at_their_level(
    fitted: Study,
) -> None:
    """Draws of another kind: each curve by itself, from draws of locations and users given the
    scales."""
    assert fitted.fit is not None
    assert fitted.setup is not None
    repeats = 8
    points = np.repeat(fitted.fit.points, repeats, axis=0)
    drawn = fitted.fit.model.draw(points, np.random.default_rng(5))
    for kind, responses in zip(("mean", "user"), drawn, strict=True):
        native = fitted.fit.scale.native(responses)
        for environment in fitted.fit.environments:
            k, b = native[:, fitted.fit.pair(environment)].T
            key = (environment, kind, "bayesian", "lognormal")
            point, together = (bands(fitted, shape)[key] for shape in ("pointwise", "simultaneous"))
            curves = perceived_magnitude(
                fitted.setup.loop,
                point.omega[:, None],
                k,
                b,
            )
            below, above = curves < point.lower[:, None], curves > point.upper[:, None]
            inside = (together.lower[:, None] <= curves) & (curves <= together.upper[:, None])
            # Of each set of scales the draws are independent: their scatter is the sets' and the
            # draws'.
            for out, share in ((below, 0.005), (above, 0.005), (~inside.all(axis=0)[None], 0.01)):
                sets = out.reshape(len(out), -1, repeats).mean(axis=2)
                error = sets.std(axis=1) / np.sqrt(sets.shape[1])
                assert (np.abs(out.mean(axis=1) - share) < 4.5 * error + 0.02 * share).all()


def test_published_limits_have_no_boundary_that_needs_a_correlation() -> None:
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical")
    study = Study(read_sessions(DATASETS / "hbfd_table1.csv"), scene)
    assert {(joint, shape) for _, _, joint, shape in keys(study)} == {
        (joint, shape) for joint in ("marginal", "bonferroni") for shape in ("corner", "envelope")
    }
    assert study.curve_laws == ()


def test_an_environment_that_is_not_there_is_named(fitted):
    with pytest.raises(
        UsageError, match=r"'VE9': the study has no such environment; there are VE1"
    ):
        fitted.boundaries_of("VE9")


def test_curves_are_of_the_scenes_family_unless_all_are_asked_for():
    found, everything = (
        study(frequency={"points": 5}, report={"curves": curves}) for curves in ("family", "all")
    )
    drawn = found.curves
    assert set(drawn["family"]) == {"lognormal"}
    both = everything.curves
    same = both[both["family"] == "lognormal"]
    pd.testing.assert_frame_equal(drawn, same.reset_index(drop=True), check_exact=True)
    assert set(both["family"]) == set(found.intervals["family"]) == {"lognormal", "normal"}
    assert found.coupling.memberships == everything.coupling.memberships


def test_without_a_logarithm_curves_are_of_the_other_family():
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table.query("environment < 'VE3'")
    table.loc[table.index[0], "b_adj"] = 0.0
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical", kinds=("user",))
    families = Study(Sessions.from_frame(table), scene).curves.groupby("environment")["family"]
    assert families.unique().explode().to_dict() == {"VE1": "normal", "VE2": "lognormal"}


MODE = {"mass": 0.5, "stiffness": 2500.0}  # at 70.7 rad/s


def study(**tables):
    """One environment, whose next user alone is asked for."""
    scene = (
        Scene.load(DATASETS / "hbfd.toml")
        .with_inference(method="classical", kinds=("user",))
        .to_dict()
    )
    scene["device"]["modes"] = [MODE]
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    one = Sessions.from_frame(table[table["environment"] == "VE3"])
    return Study(one, Scene(**{**scene, **tables}))


@pytest.mark.parametrize("points", [None, 41])
def test_an_undamped_mode_leaves_no_hole_in_the_numbers(points):
    frequency = {"lower": 1.0, "upper": 100.0} | ({"points": points} if points else {})
    found = study(frequency=frequency)
    for boundary in found.boundaries:
        assert np.all(np.diff(boundary.omega) > 0)
        assert not np.isnan([boundary.lower, boundary.upper, boundary.reference]).any()
        if not points:
            assert np.isfinite([boundary.lower, boundary.upper]).all()
    assert found.coupling is not None
    for row in found.coupling.memberships:
        numbers = [value for value in vars(row).values() if isinstance(value, float)]
        assert np.isfinite(numbers).all()


def compared(**inference):
    return compared_study(**inference).band_pairs


def compared_study(*, method="both", **inference):
    """How the methods' bands differ in a study of eight subjects with a device."""
    tables = {"device": {"mass": 1.0, "damping": 5.0, "period": 0.001}}
    if inference.get("family") == "normal":
        tables["model"] = {"pooling": "none", "prior": "reference"}
    asked = {"method": method, "tolerance": 0.05, "seed": 7, **inference}
    table = table_of(("k", "b"), subjects=8)
    return Study(Sessions.from_frame(table), Scene(inference=asked, **tables))


def test_bands_of_the_hierarchical_model_differ_as_their_curves_do() -> None:
    study = compared_study(tolerance=0.3, kinds=("user",))
    drawn = {(b.method, b.environment, b.kind): b for b in study.boundaries if is_marginal(b)}
    assert {pair.family for pair in study.band_pairs} == {"lognormal"}
    for pair in study.band_pairs:
        old, new = (drawn[m, pair.environment, pair.kind] for m in ("classical", "bayesian"))
        at = int(np.flatnonzero(old.omega == pair.width_omega)[0])
        ratio = (new.upper[at] - new.lower[at]) / (old.upper[at] - old.lower[at])
        assert pair.width == pytest.approx(np.log(ratio), rel=1e-12)
        apart = abs(np.log((new.upper - new.lower) / (old.upper - old.lower)))
        assert abs(pair.width) == pytest.approx(apart.max(), rel=1e-12)
        assert apart.min() <= abs(pair.width_median) <= apart.max()
    assert any(abs(pair.width) > 0.05 for pair in study.band_pairs)
    assert compared(method="classical") is None


def is_marginal(boundary: Boundary) -> bool:
    curve = boundary.shape, boundary.joint, boundary.family
    return curve == ("envelope", "marginal", "lognormal")
