"""Bands beside the impedance of their environments, and their ends over limits."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import Scene, Study, read_sessions
from percept.report.boundaries import boundaries
from percept.sessions import Sessions
from percept.study.band import Banded, posterior_replicates
from tests import DATASETS


def test_bands_are_relative_to_the_impedance_of_the_reference(fitted: Study) -> None:
    band = fitted.band
    assert band is not None
    for row in band.rows:
        k, b = (fitted.data.reference[p, row.environment] for p in ("k", "b"))
        assert row.impedance == pytest.approx(abs(b + k / (1j * band.omega)), rel=1e-12)
        assert row.relative == pytest.approx(row.band / row.impedance, rel=1e-12)


def test_bands_of_posterior_draws_hold_the_central_users(fitted: Study) -> None:
    """Of 99 %, on the logarithm: 2.58 SDs of users to either side, in the median over draws."""
    fit = fitted.fit
    assert fit is not None
    limits = posterior_replicates(fit)["bayesian", "lognormal"]
    for cell, number in fit.column.items():
        lower, upper = limits[cell]
        sd = np.median(fit.moments.population_sd[:, number])
        half_width = 0.5 * np.median(np.log(upper / lower))
        assert half_width == pytest.approx(stats.norm.isf(0.005) * sd, rel=0.05)


def test_a_zero_in_every_environment_leaves_the_normal_family_s_laws() -> None:
    rows = [
        (subject, environment, 10.0, 0.0 if subject == "a" else value + step)
        for step, environment in enumerate(("x", "y"))
        for subject, value in zip("abcd", (0.0, 12.0, 11.0, 9.0), strict=True)
    ]
    frame = pd.DataFrame(rows, columns=["subject", "environment", "k_ref", "k_adj"])
    scene = Scene(inference={"method": "classical"})
    study = Study(Sessions.from_frame(frame, scene=scene), scene)
    assert {row.family for row in study.results().intervals} == {"normal"}


def test_the_size_of_an_environment_ranges_over_its_limits_as_on_a_grid() -> None:
    for k, b in (
        ((900.0, 1100.0), (0.5, 2.0)),
        ((-50.0, 100.0), (-0.5, 2.0)),
        ((10.0, 20.0), (-3.0, -1.0)),
    ):
        grid = np.hypot(*np.meshgrid(np.linspace(*b, 501), np.linspace(*k, 501) / 10.0))
        limits = {("k", "E"): tuple(map(np.asarray, k)), ("b", "E"): tuple(map(np.asarray, b))}
        lower, upper = Banded(None, {"E": 1.0}, 10.0).ends(limits)["E"]
        assert float(upper) == pytest.approx(grid.max(), rel=1e-14)
        assert float(lower) == pytest.approx(grid.min(), abs=0.05)


def test_two_subjects_leave_a_limit_open_and_no_law() -> None:
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical")
    two = Study(Sessions.from_frame(table[table["subject"].isin(["S01", "S02"])]), scene)
    assert two.band is not None
    bands = {(row.environment, row.family): row for row in two.band.rows}
    assert bands["VE1", "lognormal"].upper == bands["VE1", "lognormal"].relative == np.inf
    assert bands["VE2", "lognormal"].band == pytest.approx(50.03, rel=1e-3)
    assert {law.family for law in two.band.laws} == {"normal"}
    (page,) = [part for part in boundaries(two.results()).parts if part.name == "band"]
    assert page.sentences == [
        "In VE1 there are too few subjects for a finite upper limit. Without it no law is fitted."
    ]
