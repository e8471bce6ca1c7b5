"""The envelope by points: always inside the exact one, and nearer the more points there are."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
import pytest

from percept import Scene, Study, read_sessions
from percept.bench.envelope import _ellipse, _rectangle, envelope_costs
from percept.study.regions import Region
from tests import DATASETS


@pytest.fixture(scope="module")
def study() -> Study:
    sessions = read_sessions(DATASETS / "hbfd_sessions.csv")
    two = sessions.table[sessions.table["environment"].isin(["VE1", "VE4"])]
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(tolerance=0.2)
    return Study(dataclasses.replace(sessions, table=two), scene)


def test_points_come_nearer_and_percept_is_exact(study: Study) -> None:
    found = envelope_costs(study, frequencies=60, repeats=1)
    assert [(one.environment, one.region) for one in found[::4]] == [
        ("VE1", "rectangle"), ("VE4", "rectangle"), ("VE1", "ellipse"), ("VE4", "ellipse"),
    ]  # fmt: skip
    for first in range(0, len(found), 4):
        ours, *points = found[first : first + 4]
        assert (ours.way, ours.points, ours.ratio, ours.error) == ("percept", None, 1.0, 0.0)
        assert [one.points for one in points] == (
            [64, 1024, 16_384] if ours.region == "rectangle" else [40, 160, 640]
        )
        errors = [one.error for one in points]
        # Where corners are all there is to it, points have them too, and differ by rounding.
        assert all(later <= earlier + 1e-12 for earlier, later in itertools.pairwise(errors))
        assert errors[-1] < 0.01
    assert max(one.error for one in found if one.points == 40) > 0.001


@pytest.mark.parametrize("points", [_rectangle, _ellipse])
def test_points_lie_in_their_region(study: Study, points: Callable[[Region, int], np.ndarray]) -> None:
    def right(region: Region) -> bool:
        return (region.ellipse is None) == (points is _rectangle)

    region = next(r for r in study.regions if r.method == "bayesian" and right(r))
    inside = points(region, 16)
    assert (region.depths(*inside) > -1e-9).all()
    # On the edge too, where the farthest point always is.
    assert region.depths(*inside).min() < 1e-9
