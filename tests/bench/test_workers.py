import pytest

from percept.bench.workers import batch_costs
from tests.workers.clusters import QUIET


@QUIET
def test_parts_of_a_batch_s_cost_belong_together():
    pytest.importorskip("distributed", reason="needs the extra percept[cluster]")
    small, large = batch_costs(3, workers=(1,), published=1, tolerance=0.5)
    assert [(one.design, one.workers, one.studies) for one in (small, large)] == [
        ("small", 1, 3),
        ("published", 1, 1),
    ]
    assert small.gain == 1.0
    assert large.gain is None
    for one in (small, large):
        # One thread at work, and the worker's heartbeats beside it.
        assert 0.0 < one.busy <= 1.2
        assert one.worker_s == pytest.approx(one.busy * one.wall_s / one.studies)
        assert 0.0 <= one.idle < 1.0
        assert one.write_wait_ms >= 0.9 * one.write_ms
        assert one.returned_bytes > one.sent_bytes
    assert large.sent_bytes > small.sent_bytes > 700  # rows of text and the scene
    assert large.worker_s > small.worker_s
