"""Bands beside the impedance of their environments, and the trend of the spread."""

from __future__ import annotations

import numpy as np
import pytest

from percept import Study
from percept.study.band import weber_trend


def test_bands_are_relative_to_the_impedance_of_the_reference(fitted: Study) -> None:
    band = fitted.band
    assert band is not None
    assert len(band.rows) > 0
    for row in band.rows.itertuples():
        k, b = (fitted.reference[p, row.environment] for p in ("k", "b"))
        assert row.impedance == pytest.approx(abs(b + k / (1j * band.omega)), rel=1e-12)
        assert row.relative == pytest.approx(row.band / row.impedance, rel=1e-12)


def test_the_trend_of_the_spread_has_even_tails(fitted: Study) -> None:
    assert fitted.fit is not None
    found = weber_trend(fitted.fit, level=0.9)
    assert found is not None
    drawn = fitted.fit.model.scales(fitted.fit.points)["kappa"][1]
    for p, row in enumerate(found.itertuples()):
        # A quantile between two draws.
        assert abs(np.mean(drawn[:, p] < row.lower) - 0.05) < 2 / len(drawn)
        assert abs(np.mean(drawn[:, p] > row.upper) - 0.05) < 2 / len(drawn)
        assert row.value == pytest.approx(drawn[:, p].mean())
        assert row.below_zero == np.mean(drawn[:, p] < 0)
