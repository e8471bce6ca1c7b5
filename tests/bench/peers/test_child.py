"""Processor time of an engine is that of all its processes."""

import subprocess
import sys
from pathlib import Path

import pytest

from percept.bench.peers.child import _processor

pytestmark = pytest.mark.skipif(
    not list(Path("/proc/self/task").glob("*/children")), reason="needs a system that lists children"
)


def test_running_children_count():
    before = _processor()
    code = "print(sum(range(20_000_000)), flush=True); input()"
    child = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    with child:
        assert child.stdout.readline() == b"199999990000000\n"
        running = _processor() - before
    # Waited for, the child counts among those that ended: the sum goes on from where it was.
    # Up to rounding: clock ticks of a hundredth are added as doubles.
    assert _processor() - before > running - 1e-6 > 0.1
