"""The count follows what a process is bound to."""

import subprocess
import sys

from percept.workers import cores

PROGRAM = """
import os
from percept.workers import cores
everything = cores()
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    assert cores() == 1
print(everything)
"""


def test_a_process_bound_to_one_core_has_one():
    told = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    ).stdout
    assert int(told) == cores() >= 1
