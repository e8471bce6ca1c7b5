from __future__ import annotations

import numpy as np
import pytest

from percept import RefusalError, Scene, Study, read_sessions
from percept.haptics import Device, corner_curves
from percept.study.claims import paper_claims

SCENE = Scene.load("datasets/hbfd.toml").with_inference(method="classical")


def published(scene: Scene = SCENE) -> Study:
    return Study(read_sessions("datasets/hbfd_table1.csv"), scene)


@pytest.fixture(scope="module")
def claims() -> dict[tuple[str, bool], list[float]]:
    found: dict[tuple[str, bool], list[float]] = {}
    for claim in paper_claims(published()):
        found.setdefault((claim.topic, claim.holds), []).append(claim.margin)
    return found


def test_margins_by_hand_from_the_published_table(claims: dict[tuple[str, bool], list[float]]) -> None:
    felt = {k: k * 50e3 / (k + 50e3) for k in (1000.0, 10_000.0, 25_000.0, 50_000.0)}
    assert claims["VE2, stiffness through the coupling", True][0] == pytest.approx(1017.2 / felt[1000.0] - 1)
    assert claims["VE4, Fig. 7f", True][0] == pytest.approx(25_000 / 24_968 - 1)
    for name, k, lower in (("VE3", 10_000.0, 8979.9), ("VE4", 25_000.0, 23_316), ("VE5", 50_000.0, 39_498)):
        assert claims[f"{name}, stiffness through the coupling", True][0] == pytest.approx(
            1 - felt[k] / lower
        )
    assert claims["VE2, damping", False][0] == pytest.approx(1 / 1.2404 - 1)


def test_what_the_paper_reads_off_its_figures_is_not_all_borne_out(
    claims: dict[tuple[str, bool], list[float]],
) -> None:
    assert claims["discrimination, absolute", True][0] > 0
    low = np.hypot(1.3335, 1.902) - np.hypot(0.0356, 1.0808)
    high = np.hypot(112.34, 4782.9) - np.hypot(79.933, 3949.8)
    relative = high / np.hypot(50, 5000) - low / np.hypot(0.1, 1.0)
    assert claims["discrimination, relative", False][0] == pytest.approx(relative)
    assert claims["coupling and impedance", False][0] == pytest.approx(-0.501, abs=1e-3)
    assert claims["smaller through a coupling", False][0] < 0
    assert claims["smaller through a coupling", True][0] > 0
    assert claims["absolute stability", False][0] == pytest.approx(5.0 / 15.8384 - 1, rel=1e-5)


def test_the_heaviest_device_is_where_fig_7d_ends(claims: dict[tuple[str, bool], list[float]]) -> None:
    heaviest = claims["VE2, Fig. 7d", True][1] + 1.0
    omega = np.linspace(9.9, 10.1, 401)
    for mass, holds in ((heaviest * 0.999, True), (heaviest * 1.001, False)):
        scene = SCENE.model_copy(update={"device": SCENE.device.model_copy(update={"mass": mass})})  # type: ignore[union-attr]
        margin = next(c.margin for c in paper_claims(published(scene)) if c.topic == "VE2, Fig. 7d")
        assert (margin > 0) == holds
        low, high = corner_curves(omega, Device(mass, 5.0), (944.85, 1017.2), (1.2404, 1.5316), 1e-3)
        for coupled in (False, True):
            shown = published(scene).bench.curve("VE2", omega, coupled=coupled)  # type: ignore[union-attr]
            inside = ((low <= shown) & (shown <= high)).all()
            if holds:
                assert inside
    assert 9.3 < heaviest < 9.6


def test_refused_without_the_published_environments_or_a_coupling() -> None:
    with pytest.raises(RefusalError, match="need a rigid device and a coupling"):
        paper_claims(published(SCENE.model_copy(update={"coupling": None})))
    study = published()
    table = study.sessions.table
    study.sessions.__dict__["table"] = table[table["environment"] != "VE3"]
    with pytest.raises(RefusalError, match="the data have VE1, VE2, VE4, VE5"):
        paper_claims(study)
