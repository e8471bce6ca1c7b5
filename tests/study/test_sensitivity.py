from __future__ import annotations

import numpy as np
import pytest

from percept import Scene, Study, haptics, read_sessions
from percept.sessions import Sessions
from percept.study.device import DeviceSensitivity
from tests import DATASETS

PERIOD = 0.001
DATASET = str(DATASETS / "hbfd_sessions.csv")


def scene_of(**tables: dict[str, object] | None) -> Scene:
    """The published scene, classical, with fewer frequencies; tables replaced, or left out for None."""
    given = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical").to_dict()
    given["frequency"]["points"] = 31
    return Scene.from_tables(
        {name: table for name, table in {**given, **tables}.items() if table is not None}
    )


@pytest.fixture(scope="module")
def study() -> Study:
    return Study(read_sessions(DATASET), scene_of())


def found_for(study: Study) -> DeviceSensitivity:
    assert study.sensitivity is not None
    return study.sensitivity


def box_of(study: Study, environment: str, kind: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Limits of k and b, straight from the intervals."""
    rows = study.intervals.query(
        "environment == @environment and kind == @kind and family == 'lognormal' and joint == 'marginal'"
    ).set_index("parameter")
    k, b = (tuple(rows.loc[p, ["lower", "upper"]].astype(float)) for p in ("k", "b"))
    return k, b  # type: ignore[return-value]


def test_stability_turns_where_the_required_damping_lies(study: Study) -> None:
    found = found_for(study)
    # Derived for 50 kN/m and 100 N·s/m at 1 ms.
    assert found.required_damping == pytest.approx(15.8384, abs=5e-5)
    for damping, verdicts in zip(found.damping, found.verdict, strict=True):
        assert set(verdicts) == {"stable" if damping > found.required_damping else "unstable"}


@pytest.mark.parametrize(("i", "j"), [(0, 6), (3, 3), (6, 0)])
def test_counts_are_those_of_a_search_over_all_points_of_the_box(study: Study, i: int, j: int) -> None:
    found = found_for(study)
    device = haptics.Device(found.mass[j], found.damping[i])
    coupling = haptics.Coupling(50e3, 100.0)
    inside = 0
    for environment in study.environments:
        k, b = box_of(study, environment, "user")
        reference = haptics.Environment(study.reference["k", environment], study.reference["b", environment])
        felt = abs(haptics.perceived_impedance(study.omega, device, reference, PERIOD, coupling=coupling))
        grid = haptics.Environment(np.linspace(*k, 60)[None, :, None], np.linspace(*b, 60)[None, None, :])
        seen = abs(haptics.perceived_impedance(study.omega[:, None, None], device, grid, PERIOD))
        # A grid sees less than the box holds; a felt impedance clearly outside is outside for both.
        slack = 0.02 * felt
        low, high = seen.min(axis=(1, 2)) - slack, seen.max(axis=(1, 2)) + slack
        inside += bool(((low <= felt) & (felt <= high)).all())
    assert found.inside["user"][i][j] == inside


def test_modes_count_and_a_measured_device_is_left_alone(study: Study, tmp_path) -> None:
    table = study.sessions.table
    alone = Sessions.from_frame(table[table["environment"] == "VE1"])
    rigid = found_for(Study(alone, scene_of()))
    # A mode so light and stiff that it adds its mass and nothing else below 100 rad/s.
    mode = {"mass": 1e-6, "stiffness": 1e4, "damping": 1.0}
    modal = scene_of(device={"mass": 1.0, "damping": 5.0, "period": PERIOD, "modes": [mode]})
    assert found_for(Study(alone, modal)).inside == rigid.inside
    response = tmp_path / "zd.csv"
    omega = np.geomspace(0.05, 1000.0, 50)
    impedance = haptics.device_impedance(omega, haptics.Device(1.0, 5.0), PERIOD)
    lines = [f"{w!r},{z.real!r},{z.imag!r}" for w, z in zip(omega.tolist(), impedance.tolist(), strict=True)]
    response.write_text("omega,real,imaginary\n" + "\n".join(lines) + "\n")
    measured = scene_of(device={"response": str(response), "period": PERIOD})
    assert Study(alone, measured).sensitivity is None


def test_without_a_coupling_the_reference_itself_is_judged(study: Study) -> None:
    found = found_for(Study(study.sessions, scene_of(coupling=None)))
    assert found.required_damping is None
    assert {verdict for row in found.verdict for verdict in row} == {None}
    held = 0
    for name in study.environments:
        k, b = box_of(study, name, "user")
        held += k[0] <= study.reference["k", name] <= k[1] and b[0] <= study.reference["b", name] <= b[1]
    # A reference inside its own box of k and b is inside at every ω, with any device; others may be.
    assert held == 4
    assert {count >= held for row in found.inside["user"] for count in row} == {True}


def test_nothing_to_vary_without_a_device(study: Study) -> None:
    assert Study(study.sessions, scene_of(device=None, coupling=None)).sensitivity is None


def test_the_scene_s_own_device_is_found_where_a_scale_starts_at_zero(study: Study) -> None:
    found = found_for(Study(study.sessions, scene_of(device={"mass": 1.0, "damping": 0.0, "period": PERIOD})))
    i, j = found.own
    assert (found.damping[i], found.mass[j]) == (0.0, 1.0)
