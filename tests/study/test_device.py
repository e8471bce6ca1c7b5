"""The device: measured responses, passivity, and how verdicts move with mass and damping."""

from __future__ import annotations

import numpy as np
import pytest

from percept import Scene, Study, haptics, read_sessions
from percept.errors import UsageError
from percept.results import Sensitivity
from percept.sessions import Sessions
from percept.study.device import device_of, read_response
from tests import DATASETS


def write(tmp_path, *rows):
    path = tmp_path / "zd.csv"
    path.write_text("omega,real,imaginary\n" + "\n".join(rows) + "\n")
    return str(path)


def test_values_are_those_of_the_file(tmp_path):
    device = read_response(write(tmp_path, "0.1,5,-2e3", "1,5.25,1", "10,6,10"))
    np.testing.assert_array_equal(device.omega, [0.1, 1.0, 10.0])
    np.testing.assert_array_equal(device.impedance, [5 - 2e3j, 5.25 + 1j, 6 + 10j])


@pytest.mark.parametrize("bad", ["1,5,inf", "1,-inf,2", "1,5,nan", "1,5,"])
def test_what_is_not_finite_is_refused_with_the_file(tmp_path, bad):
    path = write(tmp_path, "0.1,5,1", bad, "10,6,10")
    with pytest.raises(UsageError, match="finite") as caught:
        read_response(path)
    assert caught.value.file == path


def test_text_in_a_number_is_refused_with_the_file(tmp_path):
    path = write(tmp_path, "0.1,5,1", "1,five,2")
    with pytest.raises(UsageError, match=r"cannot be read: .*five") as caught:
        read_response(path)
    assert caught.value.file == path


def test_a_missing_column_is_named(tmp_path):
    path = tmp_path / "zd.csv"
    path.write_text("omega,real\n1,2\n")
    with pytest.raises(
        UsageError, match="column 'imaginary': the column is missing; there are omega, real"
    ):
        read_response(str(path))


def scene_with(tmp_path, response, frequency=""):
    path = tmp_path / "scenes" / "scene.toml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'[device]\nresponse = "{response}"\nperiod = 0.001\n[frequency]\n{frequency}')
    return Scene.load(path)


def test_its_path_starts_from_the_scene_s_folder(tmp_path, monkeypatch):
    write(tmp_path, "0.1,5,1", "100,6,10")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    scene = scene_with(tmp_path, "../zd.csv")
    for one in (scene, scene.with_inference(level=0.9), scene.with_tables(checks={})):
        assert device_of(one).impedance[0] == 5 + 1j
    assert scene.to_dict()["device"]["response"] == "../zd.csv"
    assert device_of(scene_with(tmp_path, tmp_path / "zd.csv")).impedance[0] == 5 + 1j
    # Nothing is looked for where the command happens to run.
    write(elsewhere, "0.1,7,1", "100,7,10")
    with pytest.raises(UsageError, match="cannot be read") as caught:
        device_of(scene_with(tmp_path, "zd.csv"))
    assert caught.value.file == str(tmp_path / "scenes" / "zd.csv")


@pytest.mark.parametrize(("end", "value"), [("lower", 0.05), ("upper", 200.0)])
def test_a_table_that_does_not_cover_the_scene_is_refused(tmp_path, end, value):
    write(tmp_path, "0.1,5,1", "100,6,10")
    with pytest.raises(
        UsageError, match=r"covers 0.1 to 100 rad/s only.*narrow \[frequency\]"
    ) as caught:
        device_of(scene_with(tmp_path, "../zd.csv", f"{end} = {value}\n"))
    assert (caught.value.key, caught.value.value) == (f"frequency.{end}", value)


OMEGA = np.geomspace(0.1, 100.0, 241)
PERIOD = 0.001
DATASET = str(DATASETS / "hbfd_sessions.csv")


def scene_of(**tables: dict[str, object] | None) -> Scene:
    """The published scene, classical, with fewer frequencies; tables replaced, or left out for
    None."""
    given = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical").to_dict()
    given["frequency"]["points"] = 31
    return Scene(
        **{name: table for name, table in {**given, **tables}.items() if table is not None}
    )


@pytest.fixture(scope="module")
def study() -> Study:
    return Study(read_sessions(DATASET), scene_of())


def found_for(study: Study) -> Sensitivity:
    assert study.parts.sensitivity is not None
    return study.parts.sensitivity


def box_of(
    study: Study, environment: str, kind: str
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Limits of k and b, straight from the intervals."""
    rows = study.intervals.query(
        "environment == @environment and kind == @kind and family == 'lognormal' and joint =="
        " 'marginal'"
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
def test_counts_are_those_of_a_search_over_all_points_of_the_box(
    study: Study, i: int, j: int
) -> None:
    found = found_for(study)
    device = haptics.Device(found.mass[j], found.damping[i])
    coupling = haptics.Coupling(50e3, 100.0)
    inside = 0
    for environment in study.parts.environments:
        k, b = box_of(study, environment, "user")
        reference = haptics.Environment(
            study.parts.reference["k", environment], study.parts.reference["b", environment]
        )
        felt = abs(haptics.perceived_impedance(OMEGA, device, reference, PERIOD, coupling=coupling))
        grid = haptics.Environment(
            np.linspace(*k, 60)[None, :, None], np.linspace(*b, 60)[None, None, :]
        )
        seen = abs(haptics.perceived_impedance(OMEGA[:, None, None], device, grid, PERIOD))
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
    lines = [
        f"{w!r},{z.real!r},{z.imag!r}"
        for w, z in zip(omega.tolist(), impedance.tolist(), strict=True)
    ]
    response.write_text("omega,real,imaginary\n" + "\n".join(lines) + "\n")
    measured = scene_of(device={"response": str(response), "period": PERIOD})
    assert Study(alone, measured).parts.sensitivity is None


def test_without_a_coupling_the_reference_itself_is_judged(study: Study) -> None:
    found = found_for(Study(study.sessions, scene_of(coupling=None)))
    assert found.required_damping is None
    assert {verdict for row in found.verdict for verdict in row} == {None}
    held = 0
    for name in study.parts.environments:
        k, b = box_of(study, name, "user")
        held += (
            k[0] <= study.parts.reference["k", name] <= k[1]
            and b[0] <= study.parts.reference["b", name] <= b[1]
        )
    # A reference inside its own box of k and b is inside at every ω, with any device; others may
    # be.
    assert held == 4
    assert {count >= held for row in found.inside["user"] for count in row} == {True}


def test_nothing_to_vary_without_a_device(study: Study) -> None:
    assert Study(study.sessions, scene_of(device=None, coupling=None)).parts.sensitivity is None


def test_the_scene_s_own_device_is_found_where_a_scale_starts_at_zero(study: Study) -> None:
    found = found_for(
        Study(study.sessions, scene_of(device={"mass": 1.0, "damping": 0.0, "period": PERIOD}))
    )
    i, j = found.own
    assert (found.damping[i], found.mass[j]) == (0.0, 1.0)
