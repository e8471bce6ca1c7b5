"""Maps of couplings and of devices say what `feels_real` says of each, and ends are confirmed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from percept import Scene, Study, haptics, read_sessions
from percept.boundary.feels_real import feels_real, share_error
from percept.haptics import Coupling, Loop, can_render
from percept.sessions import Sessions
from percept.study.verdicts import frequencies, relative_sd
from tests import DATASETS, LONG

PERIOD = 0.001


def evidence(study, environment, coupling, *, draws, device=None):
    """What `feels_real` says of an environment through a coupling."""
    setup = dataclasses.replace(study.setup, coupling=coupling)
    if device is not None:
        setup = setup.with_device(device)
    users = study.map_users.draws[environment]
    omega = frequencies(setup, environment, relative_sd(users), study.scene)
    display = setup.display(environment, coupled=coupling is not None)
    return feels_real(display, users.select(slice(0, draws)), omega, central=0.99, decision=0.95)


def renders(study, environment, coupling):
    """Whether the device renders an environment with every passive hand."""
    setup = study.setup
    return can_render(setup.loop, setup.references[environment], coupling=coupling).verdict == "can"


def test_no_coupling_of_the_map_is_unstable_in_time(fitted: Study) -> None:
    design = fitted.coupling_map
    assert design is not None
    limited = {environment.name: environment.limited for environment in design.environments}
    # Of 5 N·s/m; directly they need .105, 1.5, 15, 37.5 and 75.
    assert limited == {
        "VE1": False,
        "VE2": False,
        "VE3": True,
        "VE4": True,
        "VE5": True,
    }
    for environment in design.environments:
        edge = environment.stiffness[:, -1]
        for stiffness, damping in zip(edge[::4], environment.damping[::4], strict=True):
            assert renders(fitted, environment.name, Coupling(stiffness, damping))
            beyond = renders(fitted, environment.name, Coupling(1.01 * stiffness, damping))
            assert beyond == (not environment.limited)
    shown = design.environments[2]
    # k_cT/2 + b_c < A_e·b_d/(A_e − b_d), A_e = 15 N·s/m
    assert shown.stiffness[0, -1] == pytest.approx(2 / PERIOD * 7.5, rel=1.1e-4)


def test_what_is_admissible_is_none_or_undecided_by_two_errors(fitted: Study) -> None:
    design = fitted.coupling_map
    assert design is not None
    outcomes = set()
    for environment in design.environments:
        largest = float(environment.probability.max())
        error = share_error(largest, environment.draws)
        if environment.outcome == "none":
            assert largest + 2 * error < 0.95
        elif environment.outcome == "some":
            for end in (environment.softest, environment.stiffest):
                assert end.probability - 2 * end.error >= 0.95
        else:
            assert environment.draws == 1024
            assert largest + 2 * error >= 0.95
        outcomes.add(environment.outcome)
    assert {"some", "none"} <= outcomes


def test_ends_are_confirmed_and_nothing_beyond_is_as_probable(fitted: Study) -> None:
    design = fitted.coupling_map
    assert design is not None
    ends = 0
    for environment in design.environments:
        for end, beyond in ((environment.stiffest, 1.02), (environment.softest, 0.98)):
            if end is None:
                # No coupling of the map reaches the decision by more than its error.
                assert environment.outcome != "some"
                continue
            ends += 1
            coupling = Coupling(end.stiffness, end.damping)
            assert renders(fitted, environment.name, coupling)
            found = evidence(fitted, environment.name, coupling, draws=2048)
            assert end.probability >= 0.95
            assert found.probability >= 0.95 - 3.0 * end.error
            farther = Coupling(beyond * end.stiffness, end.damping)
            if end.bound == "stability":
                assert not renders(fitted, environment.name, farther)
            elif end.bound != "map":
                less = evidence(fitted, environment.name, farther, draws=environment.draws)
                assert less.probability <= end.probability
    assert ends >= 2


def test_one_coupling_serves_all_that_some_coupling_serves(fitted: Study) -> None:
    design = fitted.coupling_map
    assert design is not None
    assert design.together is not None
    coupling = Coupling(design.together.stiffness, design.together.damping)
    served = [row.name for row in design.environments if row.outcome == "some"]
    assert 2 <= len(served) < len(design.environments)
    found = [evidence(fitted, name, coupling, draws=2048).probability for name in served]
    assert min(found) >= 0.95
    assert design.together.probability == pytest.approx(min(found), abs=0.01)
    assert all(renders(fitted, name, coupling) for name in served)


def scene_of(**tables) -> Scene:
    """The published scene, classical; tables replaced, or left out for None."""
    given = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical").to_dict()
    chosen = {name: table for name, table in {**given, **tables}.items() if table is not None}
    return Scene(**chosen)


@pytest.fixture(scope="module")
def sessions() -> Sessions:
    return read_sessions(DATASETS / "hbfd_sessions.csv")


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("subjects", [2, 3, 4] if LONG else [2, 3])
def test_the_smallest_studies_have_maps_or_a_reason(sessions, subjects) -> None:
    kept = sessions.table["subject"].isin(sorted(sessions.subjects)[:subjects])
    kept &= sessions.table["environment"].isin(["VE1", "VE2"] if LONG else ["VE1"])
    study = Study(Sessions.from_frame(sessions.table[kept]), scene_of())
    results = study.results()
    if subjects == 2:
        said = {row.what: row.why for row in results.skipped}
        assert said["admissible couplings"] == "they need a joint law of stiffness and damping"
        assert results.design is results.sensitivity is None
        return
    assert results.design.method == "classical"
    # With several there is a map of them all.
    assert len(results.design.environments) == (3 if LONG else 1)
    largest = max(environment.probability.max() for environment in results.design.environments)
    assert 0.0 < largest < 1.0
    assert {one.environment for one in results.sensitivity.verdicts} == set(
        study.sessions.environments
    )


def test_published_limits_have_no_joint_law_for_classical_maps() -> None:
    study = Study(read_sessions(DATASETS / "hbfd_table1.csv"), scene_of())
    said = {row.what: row.why for row in study.skipped_rows}
    assert said["verdicts with other mass and damping of the device"].endswith(
        "stiffness and damping"
    )


def test_other_devices_are_judged_as_a_scene_with_that_device_is(fitted: Study) -> None:
    found = fitted.other_devices
    assert found is not None
    assert found.mass == (1.0, 0.5, 1.5, 1.0, 1.0)
    assert found.damping == (5.0, 5.0, 5.0, 2.5, 7.5)
    # Of A_e = .105, 1.5, 15, 37.5, 75 and what they need through the coupling 7.5 N·s/m is no more.
    # What none of the devices renders is left out.
    shown = [(row.environment, row.coupled) for row in found.verdicts]
    assert shown == [("VE1", False), ("VE1", True), ("VE2", False), ("VE2", True)]
    for row in found.verdicts:
        assert row.rendered == (True,) * 5
        coupling = fitted.setup.coupling if row.coupled else None
        for number in (0, 2, 3):
            device = haptics.Device(found.mass[number], found.damping[number])
            searched = evidence(fitted, row.environment, coupling, draws=found.draws, device=device)
            assert row.probability[number] == pytest.approx(searched.probability, abs=0.02)
            if searched.probability > 0.97:
                assert row.probability[number] >= fitted.scene.inference.decision


def test_a_device_without_damping_keeps_none_and_carries_no_coupling(sessions) -> None:
    study = Study(sessions, scene_of(device={"mass": 1.0, "damping": 0.0, "period": PERIOD}))
    found = study.other_devices
    assert found is not None
    assert found.damping == (0.0,) * 5
    said = {row.what: row.why for row in study.skipped_rows}
    assert said["admissible couplings"] == "no coupling is stable in time with this device"


@pytest.fixture(scope="module")
def alone(sessions):
    table = sessions.table
    return Sessions.from_frame(table[table["environment"] == "VE1"])


def test_a_measured_device_is_left_alone(alone, tmp_path) -> None:
    response = tmp_path / "zd.csv"
    omega = np.geomspace(0.05, 1000.0, 50)
    impedance = haptics.device_impedance(Loop(haptics.Device(1.0, 5.0), PERIOD), omega)
    rows = zip(omega.tolist(), impedance.tolist(), strict=True)
    lines = [f"{w!r},{z.real!r},{z.imag!r}" for w, z in rows]
    response.write_text("omega,real,imaginary\n" + "\n".join(lines) + "\n")
    measured = Study(alone, scene_of(device={"response": str(response), "period": PERIOD}))
    assert measured.other_devices is measured.coupling_map is None
    said = {row.what: row.why for row in measured.skipped_rows}
    assert said["admissible couplings"].startswith("Above 1000 rad/s the device's table says")


def test_nothing_to_map_without_a_device(sessions) -> None:
    study = Study(sessions, scene_of(device=None, coupling=None))
    assert study.other_devices is study.coupling_map is None
