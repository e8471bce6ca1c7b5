"""What a coupling's verdicts stand for, and the populations that displays are held against."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import stats

from percept import Scene, Study, haptics
from percept.haptics import magnitude_envelope
from percept.study.coupling import populations, study_coupling
from percept.study.device import Setup

RANGE = (0.1, 100.0)  # rad/s


def test_a_coupling_at_the_very_limit_counts_as_unstable(fitted: Study, monkeypatch) -> None:
    assert fitted.parts.setup is not None
    real = haptics.absolute_stability

    def at_the_limit(*args, **kwargs):
        return dataclasses.replace(real(*args, **kwargs), verdict="marginal")

    monkeypatch.setattr(haptics, "absolute_stability", at_the_limit)
    table = study_coupling(
        fitted.parts.setup, (), fitted.parts.realism, RANGE, read_at=10.0
    ).probability
    assert table is not None
    through = table[table["coupled"].astype(bool)]
    assert through["magnitude"].max() > 0.5
    assert (through["stable_and_realistic"] == 0).all()


@pytest.mark.parametrize("part", [0.999, 1.001])
def test_a_device_is_passive_from_colgate_s_damping(part: float) -> None:
    """b_d > k T/2 + b; the paper's own condition asks for less."""
    period, reference = 0.001, haptics.Environment(50e3, 50.0)
    needed = 0.5 * 50e3 * period + 50.0
    setup = Setup(
        haptics.Device(1.0, part * needed),
        period,
        "average",
        {"E": reference},
        haptics.Coupling(1e3, 1.0),
    )
    table = setup.passivity
    assert table["needed_colgate"].tolist() == pytest.approx([needed])
    assert table["needed_paper"].item() < needed
    assert table["passive"].tolist() == [part > 1.0]


def test_the_level_of_all_users_lies_between_the_limits_of_every_draw(fitted: Study) -> None:
    assert fitted.fit is not None
    model = fitted.fit.model
    laws = model.laws(fitted.fit.points)
    for environment, users in populations(fitted.fit, fitted.scene.inference).items():
        for parameter, (low, high) in (("k", users.stiffness), ("b", users.damping)):
            spread = laws.population_sd[:, model.cells.index((parameter, environment))]
            standard = 0.5 * np.log(high / low) / spread
            # Of normals 99 % lie within z of 0.995.
            np.testing.assert_allclose(standard, stats.norm.ppf(0.995), rtol=1e-9)


def test_realism_throughout_is_that_of_a_fine_grid(fitted: Study) -> None:
    """VE2 leaves its boundary in a dip of abs(Z_h) near 31.6 rad/s, a few per cent wide."""
    assert fitted.fit is not None
    assert fitted.parts.setup is not None
    setup = fitted.parts.setup
    omega = np.union1d(np.geomspace(0.1, 100.0, 400), np.geomspace(28.0, 36.0, 600))
    for environment, users in populations(fitted.fit, fitted.scene.inference).items():
        limits = magnitude_envelope(
            omega[:, None], setup.device, users.stiffness, users.damping, setup.period
        )
        for coupled in (False, True):
            shown = setup.curve(environment, omega, coupled=coupled)[:, None]
            true = float(((limits[0] <= shown) & (shown <= limits[1])).all(axis=0).mean())
            found = fitted.parts.realism[environment, coupled]
            # Of the draws that leave, the grid misses a few.
            assert true - 0.3 * found.magnitude_error - 1e-12 <= found.magnitude <= true
            if environment == "VE2":
                assert found.magnitude == pytest.approx(0.49, abs=0.03)


def measured(last: float, damping: float) -> Setup:
    """A device of 1 kg as a table up to a part of the Nyquist frequency."""
    omega = np.geomspace(1e-3, last * np.pi / 1e-3, 400)
    impedance = haptics.device_impedance(omega, haptics.Device(1.0, damping), 1e-3)
    device = haptics.TabulatedDevice(omega, impedance)
    return Setup(device, 1e-3, "average", {}, haptics.Coupling(50e3, 100.0))


def test_a_measured_device_is_stable_with_a_word_on_its_poles() -> None:
    # 15.84 N·s/m are needed; a rigid device's poles are known, a table's are not.
    found = study_coupling(measured(0.9999, 16.0), [], {}, RANGE, read_at=10.0)
    assert found.verdict == "stable"
    assert found.reason.startswith(
        "The device is measured, so its poles cannot be checked. The smallest margin is 1.01"
    )
    for setup, verdict in ((measured(0.9999, 5.0), "unstable"), (measured(0.5, 16.0), "undecided")):
        without = study_coupling(setup, [], {}, RANGE, read_at=10.0)
        assert without.verdict == verdict
        assert "poles" not in without.reason


def test_no_grid_moves_a_probability(fitted: Study) -> None:
    coarse = fitted.scene.to_dict()
    coarse["frequency"]["points"] = 5
    study = Study(fitted.sessions, Scene(**coarse))
    study.__dict__["_fit"] = fitted.fit  # the same posterior, not sampled again
    for key, found in fitted.parts.realism.items():
        assert dataclasses.asdict(study.parts.realism[key]) == dataclasses.asdict(found)


def test_verdicts_of_envelopes_are_those_of_a_fine_grid(fitted: Study) -> None:
    assert fitted.parts.setup is not None
    assert fitted.coupling is not None
    setup, omega = fitted.parts.setup, np.geomspace(0.1, 100.0, 20_000)
    regions = {r.environment: r for r in fitted.parts.regions if _of_user(r)}
    table = fitted.coupling.realism
    verdicts = set()
    for row in table[(table["shape"] == "envelope") & table.apply(_of_user, axis=1)].to_dict(
        "records"
    ):
        limits = regions[row["environment"]].limits
        assert limits is not None
        lower, upper = magnitude_envelope(omega, setup.device, *limits, setup.period)
        for coupled, name in ((False, "uncoupled"), (True, "coupled")):
            shown = setup.curve(row["environment"], omega, coupled=coupled)
            seen = float(np.maximum(shown / upper, lower / shown).max()) - 1.0
            assert row[f"departure_{name}"] == pytest.approx(seen, rel=1e-3, abs=1e-6)
            assert row[f"verdict_{name}"] == ("outside" if seen > 0 else "inside")
            verdicts.add(row[f"verdict_{name}"])
    assert verdicts == {"inside", "outside"}


def _of_user(one) -> bool:
    return (one.method, one.kind, one.family, one.joint) == (
        "bayesian",
        "user",
        "lognormal",
        "marginal",
    )
