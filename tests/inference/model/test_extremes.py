"""The collapsed density at the edges of the promise, against a dense evaluation in 60 digits."""

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mpmath import mp

from percept.inference.model.model import plain_model
from percept.inference.model.statistics import from_trials
from tests import LONG
from tests.inference.model import exact

BOUND = 1e-9


def powers(low, high):
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


@dataclasses.dataclass(frozen=True)
class Case:
    """A study with scales of every level, as doubles."""

    counts: tuple[tuple[int, ...], ...]
    parameters: int
    sd_u: tuple[float, ...]
    sd_w: tuple[tuple[float, ...], ...]
    sd_e: tuple[tuple[float, ...], ...]
    tau: tuple[float, ...]
    rho: tuple[tuple[float, float], ...]
    seed: int


@st.composite
def cases(draw):
    """Any design, with data of order one at any scales."""
    subjects, environments, size = (
        draw(st.integers(2, 4)),
        draw(st.integers(1, 3)),
        draw(st.integers(1, 2)),
    )
    sd = powers(-6.0, 6.0)  # variances 1e-12 to 1e12
    correlations = st.tuples(st.sampled_from([-1.0, 1.0]), powers(-9.0, 0.0))
    count = st.integers(0, 2)
    counts = draw(
        st.lists(st.tuples(*[count] * environments), min_size=subjects, max_size=subjects).filter(
            lambda rows: all(map(sum, rows)) and all(map(sum, zip(*rows, strict=True)))
        )
    )
    sds = st.tuples(*[sd] * size)
    return Case(
        counts=tuple(counts),
        parameters=size,
        sd_u=draw(sds),
        sd_w=tuple(draw(sds) for _ in range(environments)),
        sd_e=tuple(draw(sds) for _ in range(environments)),
        tau=draw(sds),
        rho=tuple(draw(correlations) for _ in range(3)),
        seed=draw(st.integers(0, 2**31)),
    )


def build(case):
    """Trials, statistics and the density of a case."""
    rng = np.random.default_rng(case.seed)
    subjects, environments, size = len(case.counts), len(case.counts[0]), case.parameters
    cells = np.repeat(np.arange(subjects * environments), np.ravel(case.counts))
    subject, environment = np.divmod(cells, environments)
    x = np.sort(rng.normal(size=(size, environments)), axis=1)
    x -= x.mean(axis=1, keepdims=True)
    response = 0.3 * rng.normal(size=(len(subject), size))
    statistics = from_trials(
        response,
        subject,
        environment,
        x,
        parameters=("k", "b")[:size],
        environments=tuple(f"VE{j}" for j in range(environments)),
        subjects=tuple(f"S{i}" for i in range(subjects)),
    )
    return response, subject, environment, x, plain_model(statistics)


def scales_of(case, model):
    """Scales of one draw, with the case's values instead of those of coordinates."""
    named = {
        "sigma": np.transpose(case.sd_w)[..., None],
        "sigma_e": np.transpose(case.sd_e)[..., None],
        "sigma_u": np.array(case.sd_u)[:, None],
        "tau": np.array(case.tau)[:, None],
    }
    rests = {}
    if case.parameters == 2:
        for name, (sign, rest) in zip(("rho_u", "rho_w", "rho_e"), case.rho, strict=True):
            named[name] = np.array([sign * (1.0 - rest)])
            rests[name] = np.array([rest])
    return model.coordinates.cell_scales(named, rests, model.design)


def reference(case, response, subject, environment, x, model):
    several = len(case.sd_w) > 1
    repeats = model.statistics.repeats
    return exact.log_likelihood(
        response,
        subject,
        environment,
        x,
        between=[exact.covariance(sd, *case.rho[1]) for sd in case.sd_w],
        shared=exact.covariance(case.sd_u, *case.rho[0]) if several else None,
        trial=[exact.covariance(sd, *case.rho[2]) for sd in case.sd_e] if repeats else None,
        tau=case.tau if several else None,
    )


def check(case):
    response, subject, environment, x, density = build(case)
    value = density.log_likelihood(scales_of(case, density))[0]
    with mp.workdps(exact.DIGITS):
        wanted = float(reference(case, response, subject, environment, x, density))
    assert np.isfinite(value)
    assert abs(value - wanted) <= BOUND * (1 + abs(wanted))


@pytest.mark.evidence(reduced=True)
@settings(
    max_examples=80 if LONG else 30, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
@given(cases())
def test_any_design_at_any_scales(case):
    check(case)


@pytest.mark.parametrize("rest", [1e-9, 1e-3])
@pytest.mark.parametrize("sd", [1e-6, 1e6])
def test_all_scales_at_one_end(sd, rest):
    both = (sd, sd)
    case = Case(
        counts=((1, 1), (2, 1), (1, 0)),
        parameters=2,
        sd_u=both,
        sd_w=(both, both),
        sd_e=(both, both),
        tau=both,
        rho=((1.0, rest), (-1.0, rest), (1.0, rest)),
        seed=4,
    )
    check(case)


@pytest.mark.evidence(reduced=True)
@settings(
    max_examples=100 if LONG else 40, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
@given(cases(), st.floats(0.0, 35.0), st.integers(0, 2**31))
def test_never_nan_for_any_coordinates(case, reach, seed):
    *_, density = build(case)
    points = np.random.default_rng(seed).uniform(-reach, reach, size=(16, len(density.names)))
    points[0] = reach
    points[1] = -reach
    values = density(points)
    assert not np.isnan(values).any()
    assert not np.isposinf(values).any()
