"""Data far more precise than the prior: the density keeps its digits, and intervals their width."""

import numpy as np
import pytest
from mpmath import mp
from scipy import stats

from percept.inference.model.limits import Limits
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from tests import LONG
from tests.inference.model import exact
from tests.inference.model.designs import made

#: Coefficients of variation.
PRECISE = (1e-4, 1e-5, 1e-6, 2e-7, 1e-8)


def exact_likelihood(study, priors, scale):
    """Log likelihood in 60 digits of one quantity, with a factor `hand` of two levels or none."""
    trials = range(len(study.cell))
    level = np.zeros(study.x.shape[1])
    if "hand" in study.levels:
        level = study.levels["hand"][1] - 0.5

    def square(name, *at):
        return mp.mpf(float(scale[name][(0, *at)])) ** 2 if name in scale else mp.zero

    total = mp.matrix(len(trials), len(trials))
    for m in trials:
        for n in trials:
            a, b = study.cell[m], study.cell[n]
            contrast = mp.mpf(level[a]) * mp.mpf(level[b])
            x = mp.mpf(float(study.x[0, a])) * mp.mpf(float(study.x[0, b]))
            value = mp.mpf(priors.alpha_sd) ** 2 + mp.mpf(priors.gamma_sd) ** 2 * x
            value += mp.mpf(priors.lambda_sd) ** 2 * contrast
            if study.environment[a] == study.environment[b]:
                value += square("tau") + contrast * square("tau:hand")
            if study.subject[m] == study.subject[n]:
                value += square("sigma_u") + contrast * square("sigma_v:hand")
                if a == b:
                    value += square("sigma", a)
            if m == n:
                value += square("sigma_e", a)
            total[m, n] = value
    return float(exact.log_normal_density([mp.mpf(float(v)) for v in study.response[:, 0]], total))


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("one quantity, two levels", {"subjects": 3}),
        ("one quantity, two levels", {"subjects": 3, "trials": (1, 3), "missing": 3}),
        ("one quantity", {"subjects": 3}),
        ("one quantity", {"subjects": 4, "missing": 3}),
    ],
)
def test_the_density_of_precise_data_has_its_digits(name, changes):
    """With SDs about those of the data, and effects of environments and subjects near the prior."""
    for cv in PRECISE:
        study = made(name, cv=cv, **changes)
        model = study.model
        named = dict(model.coordinates(study.points(3)).named)
        rng = np.random.default_rng(6)
        for sd in {"sigma", "sigma_e"} & named.keys():
            named[sd] = 0.3 * cv * np.exp(rng.normal(0.0, 0.3, named[sd].shape))
        found = model.log_likelihood(model.coordinates.cell_scales(named, {}, model.design))
        with mp.workdps(exact.DIGITS):
            for s in range(3):
                scale = {name: values[..., s] for name, values in named.items()}
                wanted = exact_likelihood(study.study, model.priors, scale)
                assert found[s] == pytest.approx(wanted, abs=1e-4)


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("one quantity, two levels", {"subjects": 8}),
        ("three levels, missing cells", {"subjects": 8, "parameters": ("k",)}),
        ("plain, missing cells", {"subjects": 10}),
    ]
    if LONG
    else [("one quantity, two levels", {"subjects": 8})],
)
def test_intervals_of_precise_data_are_as_wide_as_the_classical_ones(name, changes):
    """Half-widths over those of the t-interval do not depend on the coefficient of variation.

    It is small in both studies: what they learn of spreads from the prior is next to nothing.
    """
    ratios = []
    for cv in (1e-4, 2e-7):
        model = made(name, cv=cv, **changes).model
        estimands = Limits(model, kinds=("mean",))
        run = sample(model, estimands, Settings(tolerance=0.1, seed=1))
        assert run.gate.passed, run.gate.reasons
        statistics = model.statistics
        t = stats.t.ppf(0.995, statistics.df)
        classical = t * statistics.sd / np.sqrt(statistics.df + 1.0)
        ratios.append(run.estimates.scale[: len(model.cells)] / classical.ravel())
    assert 0.5 < np.median(ratios[0]) < 1.5
    np.testing.assert_allclose(ratios[1], ratios[0], rtol=0.25)
    assert np.median(ratios[1] / ratios[0]) == pytest.approx(1.0, abs=0.1)
