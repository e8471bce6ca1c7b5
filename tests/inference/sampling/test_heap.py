"""Memory of arrays stays with the process: page faults of a process of its own are counted."""

import os
import platform
import subprocess
import sys

import pytest

COUNT = """
import resource, sys
import numpy as np
from percept.inference.sampling.heap import keep_freed_memory
if sys.argv[1] == "keep":
    keep_freed_memory()
before = 0
for turn in range(60):
    if turn == 10:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [np.ones(30_000 + i) for i in range(8)]
    del arrays
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


#: What dask sets for its workers.
TRIMMING = {"MALLOC_TRIM_THRESHOLD_": "65536"}


def faults(how: str, setting: dict[str, str]) -> int:
    others = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    command = [sys.executable, "-c", COUNT, how]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=others | setting)
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the C library is not glibc")
@pytest.mark.parametrize("setting", [{}, TRIMMING], ids=["as it comes", "as dask's workers have it"])
def test_freed_memory_stays(setting):
    # Eight arrays of 59 pages, fifty times over: 23 000 pages if they are given back every time.
    assert faults("keep", setting) < 1000
    assert faults("give back", setting) > 5000
