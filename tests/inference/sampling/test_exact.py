"""Posteriors known in closed form or published to many digits, through the same sampler and
gate."""

import numpy as np
import pytest
from mpmath import mp
from scipy import special, stats

import percept
from percept.inference import prediction_interval, t_interval, tolerance_interval
from percept.inference.model.laws import Moments
from percept.inference.sampling.diagnostics import monte_carlo_error
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from tests import DATASETS
from tests.inference.sampling.targets import Means

SESSIONS = DATASETS / "hbfd_sessions.csv"
REFERENCE = {"pooling": "none", "prior": "reference"}


def test_reference_prior_gives_the_classical_intervals_of_the_published_study():
    inference = {"family": "normal", "tolerance": 0.01, "seed": 2}
    study = percept.Study(
        percept.read_sessions(SESSIONS), percept.Scene(inference=inference, model=REFERENCE)
    )
    fit = study.fit
    assert fit.run.gate.passed, fit.run.gate.reasons
    errors = dict(zip(fit.run.estimates.names, fit.run.errors, strict=True))
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
    for (limit,), error, sign in zip(study.fit.limits["mean"], run.errors, (-1, 1), strict=True):
        wanted = float(mean + sign * half)
        # The limit is a double near the offset; its spacing adds to the Monte Carlo error.
        assert abs(limit - wanted) <= 4 * error * float(sd) + np.spacing(abs(wanted))
    if offset == 0.0:
        certified = np.array([0.132819085883166, 0.267180914116834])
        assert np.all(np.abs(np.ravel(study.fit.limits["mean"]) - certified) < 4 * run.errors * 0.1)
        laws = Moments.unpack(run.components.reshape(-1, 3))
        spread = laws.population_sd.reshape(*run.components.shape[:3], 1)
        influence = spread - spread.mean()
        error = monte_carlo_error(influence)[0]
        assert abs(spread.mean() * float(sd) - 0.108372230793914) < 4 * error * float(sd)


class EightSchools:
    """mu ~ N(0, 5), tau ~ half-Cauchy(0, 5), effects standardised; sampled in mu/5 and tau's
    score."""

    effect = np.array([28.0, 8.0, -3.0, 7.0, -1.0, 1.0, 18.0, 12.0])
    error = np.array([15.0, 10.0, 16.0, 11.0, 9.0, 11.0, 10.0, 18.0])
    names = ("mu", "tau", *(f"eta[{j}]" for j in range(8)))

    @staticmethod
    def variables(points):
        """Values of mu and tau, (W, 2)."""
        # tan(pi p/2) from the upper tail, where p is near one.
        tau = 5.0 / np.tan(0.5 * np.pi * special.ndtr(-points[:, 1]))
        return np.stack([5.0 * points[:, 0], tau], axis=1)

    def __call__(self, points):
        mu, tau = self.variables(points).T
        theta = mu[:, None] + tau[:, None] * points[:, 2:]
        misfit = (self.effect - theta) / self.error
        return -0.5 * (points**2).sum(axis=1) - 0.5 * (misfit**2).sum(axis=1)


def test_eight_schools():
    """Against E mu = 4.3968207 and E tau = 3.5977055, by quadrature."""
    estimands = Means(("E mu", "E tau"), EightSchools.variables)
    run = sample(EightSchools(), estimands, Settings(tolerance=0.01, seed=1))
    assert run.gate.passed, run.gate.reasons
    z = (run.estimates.value - np.array([4.3968207, 3.5977055])) / run.errors
    assert np.all(np.abs(z) < 4)
    assert np.all(run.errors < 0.05)
