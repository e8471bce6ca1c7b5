"""Posteriors known in closed form or published to many digits, through the same sampler and
gate."""

import numpy as np
import pytest
from mpmath import mp
from scipy import stats

import percept
from percept.inference import prediction_interval, t_interval, tolerance_interval
from tests import DATASETS

SESSIONS = DATASETS / "hbfd_sessions.csv"
REFERENCE = {"pooling": "none", "prior": "reference"}


def test_reference_prior_gives_the_classical_intervals_of_the_published_study():
    inference = {"family": "normal", "tolerance": 0.01, "seed": 2}
    study = percept.Study(
        percept.read_sessions(SESSIONS), percept.Scene(inference=inference, model=REFERENCE)
    )
    fit = study.fit
    assert fit.run.gate.passed, fit.run.gate.reasons
    errors = dict(zip(fit.run.estimates.names, fit.run.estimates.errors, strict=True))
    table = study.sessions.table
    for c, (parameter, environment) in enumerate(fit.model.cells):
        values = table.loc[table["environment"] == environment, f"{parameter}_adj"].to_numpy()
        unit = fit.scale.unit[c]
        exact = {
            "mean": t_interval(values, level=0.99),
            "user": prediction_interval(values, level=0.99),
            "share": tolerance_interval(values, share=0.99, confidence=0.95),
        }
        for kind, interval in exact.items():
            for side, limits in zip(("lower", "upper"), fit.limits[kind], strict=True):
                error = unit * errors[f"{side} {kind} limit of {parameter} in {environment}"]
                assert abs(limits[c] - getattr(interval, side)) < 4 * error, (
                    parameter,
                    environment,
                    kind,
                    side,
                )
                assert error < 0.011 * (interval.upper - interval.lower) / 2


@pytest.mark.parametrize("offset", [0.0, 1e8, 1e13])
def test_nist_markov_chain_case(offset, tmp_path):
    """n = 11, offset + {.2, .1, .3, .1, .3, ...}; at 1e13 the rounding of the data alone moves
    the answer."""
    values = [offset + v for v in [0.2, *[0.1, 0.3] * 5]]
    path = tmp_path / "nist.csv"
    rows = [f"S{i:02d},VE1,{max(1.0, offset)!r},{value!r}" for i, value in enumerate(values)]
    path.write_text("\n".join(["subject,environment,k_ref,k_adj", *rows]) + "\n")
    inference = {"family": "normal", "level": 0.95, "kinds": ("mean",), "tolerance": 0.01}
    study = percept.Study(
        percept.read_sessions(path), percept.Scene(inference=inference, model=REFERENCE)
    )
    run = study.fit.run
    assert run.gate.passed, run.gate.reasons
    with mp.workdps(40):
        mean = mp.fsum(mp.mpf(v) for v in values) / 11
        sd = mp.sqrt(mp.fsum((mp.mpf(v) - mean) ** 2 for v in values) / 10)
    half = stats.t.isf(0.025, 10) * float(sd) / np.sqrt(11)
    for (limit,), error, sign in zip(
        study.fit.limits["mean"], run.estimates.errors, (-1, 1), strict=True
    ):
        wanted = float(mean + sign * half)
        # The limit is a double near the offset; its spacing adds to the Monte Carlo error.
        assert abs(limit - wanted) <= 4 * error * float(sd) + np.spacing(abs(wanted))
    if offset == 0.0:
        certified = np.array([0.132819085883166, 0.267180914116834])
        assert np.all(
            np.abs(np.ravel(study.fit.limits["mean"]) - certified) < 4 * run.estimates.errors * 0.1
        )
