"""What a coupling's verdicts stand for."""

from __future__ import annotations

import dataclasses

import pytest

from percept import Study, haptics
from percept.study.coupling import study_coupling
from percept.study.device import Setup


def test_a_coupling_at_the_very_limit_counts_as_unstable(fitted: Study, monkeypatch) -> None:
    assert fitted.setup is not None
    real = haptics.absolute_stability

    def at_the_limit(*args, **kwargs):
        return dataclasses.replace(real(*args, **kwargs), verdict="marginal")

    monkeypatch.setattr(haptics, "absolute_stability", at_the_limit)
    table = study_coupling(fitted.setup, (), (), fitted.realism, read_at=10.0).probability
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
        haptics.Device(1.0, part * needed), period, "average", {"E": reference}, haptics.Coupling(1e3, 1.0)
    )
    table = setup.passivity
    assert table["needed_colgate"].tolist() == pytest.approx([needed])
    assert table["needed_paper"].item() < needed
    assert table["passive"].tolist() == [part > 1.0]
