from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from percept import Scene, Study, UsageError, read_sessions
from percept.boundary.membership import magnitude_membership
from percept.inference.classical.joint import ellipse_region
from percept.study.boundaries import Range, environment_boundaries, region_curves
from percept.study.coupling import study_coupling

ADAPTIVE = Range(0.1, 100.0)


def keys(study: Study, omega: np.ndarray) -> set[tuple[str, str, str, str]]:
    return {(b.method, b.kind, b.joint, b.shape) for b in study.boundaries_at(omega, ("VE3",))}


def test_every_kind_method_and_joint_treatment_has_its_boundaries(fitted: Study) -> None:
    found = keys(fitted, np.array([1.0, 10.0]))
    for method in ("classical", "bayesian"):
        for kind in ("mean", "user", "share"):
            for joint in ("marginal", "bonferroni"):
                assert {(method, kind, joint, "corner"), (method, kind, joint, "envelope")} <= found
        for kind in ("mean", "user"):
            assert (method, kind, "hotelling", "envelope") in found
            assert {(method, kind, "joint", "pointwise"), (method, kind, "joint", "simultaneous")} <= found
    assert not any(kind == "share" and joint in ("hotelling", "joint") for _, kind, joint, _ in found)


def test_published_limits_have_no_boundary_that_needs_a_correlation() -> None:
    scene = Scene.load("datasets/hbfd.toml").with_inference(method="classical")
    study = Study(read_sessions("datasets/hbfd_table1.csv"), scene)
    assert {(joint, shape) for _, _, joint, shape in keys(study, np.array([1.0, 2.0]))} == {
        (joint, shape) for joint in ("marginal", "bonferroni") for shape in ("corner", "envelope")
    }
    assert study.curve_draws == ()


def test_classical_ellipse_is_that_of_the_subjects(fitted: Study) -> None:
    table = fitted.sessions.table[fitted.sessions.table["environment"] == "VE4"]
    exact = ellipse_region(table["k_adj"], table["b_adj"], kind="user", family="lognormal")
    region = next(
        r
        for r in fitted.regions
        if (r.environment, r.method, r.kind, r.family, r.joint)
        == ("VE4", "classical", "user", "lognormal", "hotelling")
    )
    assert region.ellipse is not None
    np.testing.assert_allclose(region.ellipse.shape, exact.shape)
    assert region.ellipse.radius == exact.radius


def test_bonferroni_is_wider_and_leaves_out_half_as_many_draws(fitted: Study) -> None:
    wide = {
        (r.environment, r.kind): r.limits
        for r in fitted.regions
        if (r.method, r.joint) == ("bayesian", "bonferroni")
    }
    plain = {
        (r.environment, r.kind): r.limits
        for r in fitted.regions
        if (r.method, r.joint) == ("bayesian", "marginal")
    }
    assert wide.keys() == plain.keys()
    for key, limits in plain.items():
        assert limits is not None
        assert wide[key] is not None
        for (low, high), (lower, upper) in zip(limits, wide[key], strict=True):  # type: ignore[arg-type]
            assert lower < low
            assert high < upper
    # The limits come from a mixture of normals; draws of the same posterior count what they hold.
    for drawn in fitted.curve_draws:
        if drawn.method != "bayesian":
            continue
        for environment, pair in drawn.pairs.items():
            for values, (low, high) in zip(pair, wide[environment, drawn.kind], strict=True):  # type: ignore[arg-type]
                outside = np.mean((values < low) | (values > high))
                # Of 16000 draws some 2500 are independent.
                assert abs(outside - 0.005) < 4 * np.sqrt(0.005 / 2500)


def test_chosen_frequencies_follow_boundaries_of_the_study(fitted: Study) -> None:
    assert fitted.bench is not None
    regions = [r for r in fitted.regions if r.environment == "VE2" and r.joint != "bonferroni"]
    found = environment_boundaries(fitted.bench, "VE2", regions, [], ADAPTIVE)
    fine = np.geomspace(0.1, 100.0, 1501)
    true = environment_boundaries(fitted.bench, "VE2", regions, [], Range(0.1, 100.0, fine))
    for boundary, exact in zip(found, true, strict=True):
        floor = 0.02 * np.maximum(exact.upper, exact.reference)
        for side in ("lower", "upper", "reference", "coupled"):
            points = np.maximum(getattr(boundary, side), 1e-9)
            line = np.exp(np.interp(np.log(fine), np.log(boundary.omega), np.log(points)))
            curve = getattr(exact, side)
            assert np.abs(line / curve - 1.0)[curve > floor].max() < 1e-3
        assert boundary.omega.size < 400


def test_realism_shares_are_those_of_membership(fitted: Study) -> None:
    boundaries = fitted.boundaries_at(np.geomspace(0.1, 100.0, 15), ("VE3", "VE5"))
    assert fitted.bench is not None
    table = study_coupling(fitted.bench, boundaries, fitted.regions).realism
    assert len(table) == len(boundaries)
    for boundary, row in zip(boundaries, table.itertuples(), strict=True):
        assert boundary.coupled is not None
        member = magnitude_membership(boundary.omega, boundary.lower, boundary.upper, boundary.coupled)
        assert row.share_inside_coupled == member.inside
        assert row.leaves_coupled == member.leaves
    plane = table[table["shape"] == "envelope"]
    # Inside in the plane at every omega means inside in magnitude too, never the other way round.
    assert (plane["plane_coupled"] <= plane["share_inside_coupled"] + 1e-9).all()
    assert (plane["plane_uncoupled"] < plane["share_inside_uncoupled"] - 0.5).any()


def test_probability_of_stable_and_realistic(fitted: Study) -> None:
    assert fitted.bench is not None
    found = [(e, coupled, one) for (e, coupled), one in fitted.realism.items()]
    table = study_coupling(fitted.bench, (), (), found).probability
    assert table is not None
    through = table[table["coupled"].astype(bool)].set_index("environment")
    assert (through["stable_and_realistic"] == 0).all()  # the scene's device is too little damped
    assert through.loc["VE4", "magnitude"] < 0.01
    assert through.loc["VE1", "magnitude"] > 0.9
    assert (through["plane"] <= through["magnitude"]).all()


def test_designed_couplings_keep_the_next_user_inside(fitted: Study) -> None:
    design = fitted.coupling_design["bayesian"]
    assert fitted.bench is not None
    coupling = design.each[1].largest
    assert coupling is not None
    bench = dataclasses.replace(fitted.bench, coupling=coupling)
    region = next(
        r
        for r in fitted.regions
        if (r.environment, r.method, r.kind, r.joint) == ("VE2", "bayesian", "user", "marginal")
    )
    omega = np.geomspace(0.1, 100.0, 81)
    lower, upper = region_curves(region, "envelope", omega, bench.device, bench.period, hold=bench.hold)
    shown = bench.curve("VE2", omega, coupled=True)
    assert (shown >= lower * (1 - 1e-9)).all()
    assert (shown <= upper * (1 + 1e-9)).all()
    assert study_coupling(bench, (), ()).verdict in ("stable", "marginal")


def test_no_coupling_to_judge(fitted: Study) -> None:
    assert fitted.bench is not None
    with pytest.raises(UsageError, match="no coupling to judge"):
        study_coupling(dataclasses.replace(fitted.bench, coupling=None), (), ())
