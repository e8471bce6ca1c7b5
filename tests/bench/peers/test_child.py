"""Processor time of an engine is that of all its processes."""

from pathlib import Path

import pytest

from percept.bench.peers.child import _processor
from percept.processes import Processes

pytestmark = pytest.mark.skipif(
    not list(Path("/proc/self/task").glob("*/children")), reason="needs a system that lists children"
)


def test_running_children_count():
    work = sum, range(20_000_000)
    before = _processor()
    with Processes(2) as processes:
        answer = processes.ask(*work)
        assert answer() == 199_999_990_000_000
        running = _processor() - before
    # Waited for, the child counts among those that ended: the sum goes on from where it was.
    # Up to rounding: clock ticks of a hundredth are added as doubles.
    assert _processor() - before > running - 1e-6 > 0.1
