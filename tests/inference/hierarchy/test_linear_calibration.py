"""Truths drawn from the prior of a factor's model lie evenly in its posteriors; a wrong model is
caught."""

import dataclasses

import numpy as np
import pytest
from scipy import special, stats

from percept.inference.hierarchy.contrasts import ContrastEstimands, ContrastRows
from percept.inference.hierarchy.design import Cells, Factors, design_of
from percept.inference.hierarchy.linear import LinearModel
from percept.inference.hierarchy.models import IntervalEstimands
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.statistics import from_trials
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from tests import LONG

SUBJECTS = 8
#: Narrower than the defaults, so that few draws of the prior are studies nobody would run.
PRIORS = Priors(
    tau_scale=0.2, sigma_u_scale=0.4, log_s_mean=np.log(0.15), log_s_sd=0.4, omega_scale=0.3
)
ENVIRONMENT = np.repeat(np.arange(3), 2)
LEVEL = np.tile([0, 1], 3)
C = np.where(LEVEL == 1, 0.5, -0.5)
X = np.array([-1.0, 0.0, 1.0])[ENVIRONMENT]
#: Overall contrast of the six cells.
ROW = (2.0 / 3.0) * C


def study(rng):
    """Return trials of a study whose truth the prior gives, and that truth: contrast and log
    ratio of SDs."""
    p = PRIORS

    def half(scale):
        return abs(rng.normal(0.0, scale))

    tau, tau_c = half(p.tau_scale), half(p.tau_scale)
    beta = rng.normal(0.0, p.alpha_sd) + rng.normal(0.0, p.gamma_sd) * X
    beta = beta + rng.normal(0.0, tau, 3)[ENVIRONMENT]
    beta = beta + C * (rng.normal(0.0, p.lambda_sd) + rng.normal(0.0, tau_c, 3)[ENVIRONMENT])
    log_sigma = rng.normal(p.log_s_mean, p.log_s_sd) + rng.normal(0.0, p.kappa_sd) * X
    log_sigma = log_sigma + rng.normal(0.0, p.psi_sd) * C
    sigma = np.exp(log_sigma + rng.normal(0.0, half(p.omega_scale), 6))
    stretch = np.exp(rng.normal(0.0, p.psi_sd) * C)
    sigma_u, sigma_v = half(p.sigma_u_scale), half(p.sigma_u_scale)
    u = rng.normal(0.0, sigma_u, (SUBJECTS, 1))
    v = rng.normal(0.0, sigma_v, (SUBJECTS, 1))
    settings = beta + stretch * (u + C * v) + rng.normal(0.0, sigma, (SUBJECTS, 6))
    sds = []
    for weights in (np.maximum(ROW, 0.0), np.maximum(-ROW, 0.0)):
        shared = (sigma_u * weights @ stretch) ** 2 + (sigma_v * weights @ (stretch * C)) ** 2
        sds.append(0.5 * np.log(shared + weights**2 @ sigma**2))
    return settings, ROW @ beta, sds[0] - sds[1]


def model_of(settings, *, varied=True):
    subject, cell = np.indices(settings.shape)
    names = tuple(f"VE{j} {level}" for j, level in zip(ENVIRONMENT, LEVEL, strict=True))
    statistics = from_trials(
        settings.reshape(-1, 1),
        subject.ravel(),
        cell.ravel(),
        X[None],
        parameters=("k",),
        environments=names,
        subjects=tuple(f"S{i}" for i in range(SUBJECTS)),
    )
    cells = Cells(names, ENVIRONMENT, ("VE0", "VE1", "VE2"), X[None])
    levels = {"hand": ("left", "right")}
    factors = Factors(levels, {"hand": LEVEL}, (("hand",),), spread=("hand",))
    design = design_of(cells, factors, PRIORS)
    if not varied:
        design = dataclasses.replace(design, subject=design.subject[:1])
    return LinearModel(statistics, design, PRIORS)


def places(fits, *, varied=True, seed=1):
    """Posterior probability below each truth, (fits, 2): of the contrast and of the log ratio."""
    rng = np.random.default_rng(seed)
    found = []
    for fit in range(fits):
        settings, contrast, ratio = study(rng)
        model = model_of(settings, varied=varied)
        none = np.zeros((0, 6))
        rows = ContrastRows(cells=none, users=ROW[None], groups=none)
        claims = IntervalEstimands(model, kinds=("mean",), level=0.9)
        names = (("contrast", "overall"),)
        estimands = ContrastEstimands(model, rows, names, (), claims)
        run = sample(model, estimands, Settings(tolerance=0.1, seed=fit))
        assert run.gate.passed, run.gate.reasons
        kept = run.independent()
        points = kept.reshape(-1, kept.shape[-1])
        laws = model.laws_of(ROW[None], points)
        below = special.ndtr((contrast - laws.mean) / laws.sd).mean()
        sides = np.stack([np.maximum(ROW, 0.0), np.maximum(-ROW, 0.0)])
        second, first = model.log_user_sds(sides, points).T
        found.append([below, (second - first < ratio).mean()])
    return np.array(found)


def too_far(found):
    """Probability of truths of the contrast that lie as far out in their posteriors."""
    scores = special.ndtri(found[:, 0])
    return stats.chi2.sf(scores @ scores, len(scores))


@pytest.mark.evidence(reduced=True)
def test_truths_lie_evenly_in_their_posteriors():
    found = places(300 if LONG else 3)
    for of_quantity in found.T:
        assert stats.kstest(of_quantity, "uniform").pvalue > 1e-3
    assert too_far(found) > 1e-3


@pytest.mark.evidence
def test_a_model_without_subjects_own_contrasts_is_caught():
    assert too_far(places(100, varied=False)) < 1e-3
