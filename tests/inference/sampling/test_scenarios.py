"""Hard studies from end to end: an answer that passes the gate, or a refusal that says why."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from percept import RefusalError, Scene, Study
from percept.cli import main
from tests.documents import with_rows

KINDS = ("mean", "user", "share")
DECADES = {"k": (10.0, 5e4), "b": (0.1, 50.0)}


def responses(subjects, environments, *, seed, sd=0.2, shared=0.1):
    """Log ratios (N, J, 2) with scatter at both levels; `sd` may differ between environments."""
    rng = np.random.default_rng(seed)
    bias = 0.1 * rng.standard_normal((environments, 2))
    subject = shared * rng.standard_normal((subjects, 1, 2))
    within = np.broadcast_to(sd, environments)[:, None] * rng.standard_normal(
        (subjects, environments, 2)
    )
    return bias + subject + within


def table_of(response, *, parameters=("k", "b"), unit=1.0):
    """Sessions of log ratios (N, J, P), every reference and adjustment times `unit`."""
    subjects, environments, _ = response.shape
    subject, environment = (axis.ravel() for axis in np.indices((subjects, environments)))
    columns = {
        "subject": [f"S{i + 1:04d}" for i in subject],
        "environment": [f"VE{j + 1}" for j in environment],
    }
    for p, name in enumerate(parameters):
        low, high = DECADES[name]
        reference = unit * np.geomspace(low, high, environments)[environment]
        columns[f"{name}_ref"] = reference
        columns[f"{name}_adj"] = reference * np.exp(response[..., p].ravel())
    return pd.DataFrame(columns)


def study_of(table, *, model=None, **inference):
    asked = {"method": "bayesian", "tolerance": 0.05, "seed": 1, **inference}
    return Study(table, Scene(inference=asked, model=model or {}, checks={}))


def answered(study):
    """The fit, once the gate has passed and its limits are finite, in order and nested."""
    fit = study.fit
    assert fit.run.gate.passed, fit.run.gate.reasons
    for lower, upper in fit.limits.values():
        assert np.isfinite(lower).all()
        assert np.isfinite(upper).all()
        assert (lower < upper).all()
    asked = [kind for kind in KINDS if kind in fit.limits]
    lowers, uppers = (np.stack([fit.limits[kind][side] for kind in asked]) for side in (0, 1))
    assert (np.diff(lowers, axis=0) < 0).all()
    assert (np.diff(uppers, axis=0) > 0).all()
    return fit


def on_the_model_scale(fit):
    """Limits (kinds, sides, C) as log ratios, and their Monte Carlo errors."""
    shape = (len(fit.limits), 2, -1)
    return fit.run.estimates.value.reshape(shape), fit.run.estimates.errors.reshape(shape)


def half_widths(fit):
    limits, _ = on_the_model_scale(fit)
    return 0.5 * (limits[:, 1] - limits[:, 0])


def test_a_wild_subject_widens_its_environment_and_is_named():
    response = responses(10, 3, seed=5)[..., :1]
    wild = response.copy()
    wild[3, 1] += np.log(1000.0)
    studies = [
        study_of(table_of(one, parameters=("k",)), tolerance=0.1) for one in (response, wild)
    ]
    without, with_it = (half_widths(answered(study))[KINDS.index("user")] for study in studies)
    # One value of ten at 6.9 makes an SD of 2.2, ten times the others'.
    assert with_it[1] > 5.0 * without[1]
    assert np.all(with_it[[0, 2]] < 2.0 * without[[0, 2]])
    study = studies[1]
    found = study.checks.loo
    assert [check.subject for check in found.subjects if check.outlier] == ["S0004"]
    assert any("S0004 set stiffness in VE2 to" in message for message in found.messages)


def test_a_subject_wild_everywhere_is_an_effect_of_the_subject():
    """Adjusting 200 times too high in every environment: sigma_u takes it up, not the sigmas."""
    response = responses(10, 5, seed=9)
    wild = response.copy()
    wild[3] += np.log(200.0)
    fit = answered(study_of(table_of(wild)))
    scales = fit.model.scales(fit.run.points[:, -1].reshape(-1, fit.run.points.shape[-1]))
    within = np.log(scales["sigma"][1]).mean(axis=0)
    residual = wild - wild.mean(axis=0) - wild.mean(axis=1, keepdims=True) + wild.mean(axis=(0, 1))
    found = np.log(np.sqrt((residual**2).sum(axis=0).T / (9 * 4 / 5)))
    # 7.2 degrees of freedom a cell: a standard error of 0.26.
    assert np.all(np.abs(within - found) < 4 * 0.26)
    assert scales["sigma_u"][1].mean() > 5 * scales["sigma"][1].mean()


def identical(subjects=8):
    """One environment, adjusted to 1100 N/m by everybody."""
    return pd.DataFrame(
        {
            "subject": [f"S{i + 1}" for i in range(subjects)],
            "environment": "VE1",
            "k_ref": 1000.0,
            "k_adj": 1100.0,
        }
    )


def test_identical_subjects_are_refused_on_the_command_line_and_answered_with_a_step(
    tmp_path, capsys
):
    data, scene, out = tmp_path / "alike.csv", tmp_path / "scene.toml", tmp_path / "out"
    identical().to_csv(data, index=False)
    assert main(["fit", str(data), "--method", "bayesian", "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert "all subjects made the same adjustments in stiffness of VE1" in said
    assert "resolution.k" in said
    scene.write_text(
        '[model]\nresolution = {k = 10.0}\n[inference]\ntolerance = 0.05\nmethod = "bayesian"\n'
    )
    assert main(["fit", str(data), "--scene", str(scene), "--out", str(out)]) == 0
    rows = with_rows((out / "fit.json").read_text(encoding="utf-8"))["intervals"]
    assert {row["kind"] for row in rows} == set(KINDS)
    assert all(0 < row["lower"] < row["estimate"] < row["upper"] < np.inf for row in rows)


@pytest.mark.parametrize("environments", [1, 3])
def test_a_correlation_of_nearly_one_is_refused_with_what_to_do(environments):
    response = responses(10, environments, seed=6, shared=0.0)
    response[..., 1] = (1 - 1e-9) * response[..., 0] + np.sqrt(2e-9) * response[..., 1]
    with pytest.raises(RefusalError, match=r"stiffness and damping .* in proportion") as caught:
        _ = study_of(table_of(response)).fit
    assert "Analyse one of them" in str(caught.value)
    fit = answered(study_of(table_of(response), parameters=("k",)))
    assert {parameter for parameter, _ in fit.model.cells} == {"k"}
