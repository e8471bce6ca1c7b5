import pytest

from percept.bench.growth import batch_costs
from tests.workers.clusters import QUIET


@QUIET
def test_parts_of_a_batch_s_cost_belong_together():
    pytest.importorskip("distributed", reason="needs the extra percept[cluster]")
    (cost,) = batch_costs(3, workers=(1,), tolerance=0.5)
    assert (cost.workers, cost.studies, cost.gain) == (1, 3, 1.0)
    # One thread at work, and the worker's heartbeats beside it.
    assert 0.0 < cost.busy <= 1.2
    assert cost.worker_s == pytest.approx(cost.busy * cost.wall_s / cost.studies)
    assert cost.coordinator_ms > 0.0
