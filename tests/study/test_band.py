"""Bands beside the impedance of their environments, and laws recovered from simulated studies."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import special, stats

from percept import Scene, Study
from percept.boundary.band import LAWS, fit_law
from percept.sessions import Sessions
from percept.study.band import (
    Banded,
    Replicates,
    classical_replicates,
)
from percept.study.data import Data
from tests import LONG


def test_bands_are_relative_to_the_impedance_of_the_reference(fitted: Study) -> None:
    band = fitted.band
    assert band is not None
    for row in band.rows:
        k, b = (fitted.data.reference[p, row.environment] for p in ("k", "b"))
        assert row.impedance == pytest.approx(abs(b + k / (1j * band.omega)), rel=1e-12)
        assert row.relative == pytest.approx(row.band / row.impedance, rel=1e-12)


LEVEL, OMEGA, SUBJECTS = 0.9, 10.0, 16
RATIO = np.geomspace(1.0, 1000.0, 16)
NAMES = tuple(f"E{j}" for j in range(RATIO.size))
# Springs with next to no damper: the band of abs(Z_e) is that of k/omega, and known exactly.
STIFFNESS, DAMPING = 100.0 * RATIO, 0.001 * RATIO
IMPEDANCE = STIFFNESS / OMEGA
BANDED = Banded(None, dict(zip(NAMES, IMPEDANCE.tolist(), strict=True)), OMEGA)


def bands_of(replicates: Replicates, method: str) -> dict[str, np.ndarray]:
    """Bands of the next user by environment, from limits under the normal family."""
    ends = BANDED.ends(replicates[method, "normal"])
    return {environment: upper - lower for environment, (lower, upper) in ends.items()}


# Relative SD between users, and the parameters of the law of 1 SD of abs(Z_e) that follows.
SPREAD = {
    "weber": np.full(RATIO.size, 0.08),
    "offset": 0.05 + 0.2 / RATIO,
    "power": 0.15 * RATIO**-0.15,
}
ONE_SD = {
    "weber": {"w": 0.08},
    "offset": {"c": 2.0, "w": 0.05},
    "power": {"w": 0.15 * 10.0**0.15, "p": 0.85},
}
STUDIES = 100 if LONG else 10


def scene_of(method: str) -> Scene:
    asked = {
        "method": method,
        "kinds": ("user",),
        "level": LEVEL,
        "family": "normal",
        "tolerance": 0.1,
    }
    return Scene(inference=asked)


def simulated(law: str, seed: int) -> Sessions:
    shape = (2, SUBJECTS, RATIO.size)
    k, b = np.stack([STIFFNESS, DAMPING])[:, None] * (
        1.0 + SPREAD[law] * np.random.default_rng(seed).standard_normal(shape)
    )
    return Sessions.from_frame(
        pd.DataFrame(
            {
                "subject": np.repeat([f"S{i}" for i in range(SUBJECTS)], RATIO.size),
                "environment": np.tile(NAMES, SUBJECTS),
                "k_ref": np.tile(STIFFNESS, SUBJECTS),
                "b_ref": np.tile(DAMPING, SUBJECTS),
                "k_adj": k.ravel(),
                "b_adj": b.ravel(),
            }
        )
    )


def widened(law: str, width: float) -> np.ndarray:
    """Parameters of the law of a band of `width` SDs: an exponent stays."""
    return np.array(
        [value * (1.0 if name == "p" else width) for name, value in ONE_SD[law].items()]
    )


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("law", LAWS if LONG else ["offset"])
def test_classical_laws_hold_the_true_parameters_as_often_as_stated(law: str) -> None:
    freedom = SUBJECTS - 1
    # What the logarithm of a prediction interval's width is on average: fits are on logarithms.
    expected_sd = np.exp(0.5 * (special.digamma(freedom / 2) - np.log(freedom / 2)))
    width = (
        2.0
        * stats.t.isf(0.5 * (1.0 - LEVEL), freedom)
        * np.sqrt(1.0 + 1.0 / SUBJECTS)
        * expected_sd
    )
    true = widened(law, width)
    inside, centres = [], []
    for seed in range(STUDIES):
        data = Data(simulated(law, seed), scene_of("classical"))
        bands = bands_of(classical_replicates(data, [BANDED]), "classical")
        lower, centre, upper = np.quantile(
            fit_law(law, IMPEDANCE, np.stack(list(bands.values()), axis=1)),
            [0.05, 0.5, 0.95],
            axis=0,
        )
        inside.append((lower <= true) & (true <= upper))
        centres.append(centre)
    held = np.mean(inside, axis=0)
    assert np.all(np.abs(held - LEVEL) <= 4.0 * np.sqrt(LEVEL * (1.0 - LEVEL) / STUDIES))
    error = np.std(centres, axis=0, ddof=1) / np.sqrt(STUDIES)
    assert np.all(np.abs(np.mean(centres, axis=0) - true) < 4.0 * error)


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
