"""What a process costs: wall time, processor time and memory, of any command or function."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any

import numpy as np

from percept.errors import RefusalError

#: Starts Python from a small process, and says last what that took: s, s and kB. Linux counts the
#: memory of a process that starts another as the other's.
_START = """
import os, sys, time
started = time.perf_counter()
words = [sys.executable, *sys.argv[1:]]
_, status, usage = os.wait4(os.posix_spawn(words[0], words, os.environ), 0)
wall = time.perf_counter() - started
print(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss, file=sys.stderr)
sys.exit(os.waitstatus_to_exitcode(status) and 1)
"""
_MB = 1024.0  # kB


@dataclass(frozen=True)
class Cost:
    """What a process took, with all it started."""

    wall: float  # s
    processor: float  # s
    memory: float  # MB, the most at once of one process


def run_python(*words: str, timeout: float | None = None) -> tuple[str, Cost]:
    """Run Python in a process of its own, which finds no posterior of an earlier one.

    The process keeps percept's modules compiled, as installed packages are: a checkout would be
    compiled again at every start where `PYTHONDONTWRITEBYTECODE` is set.

    Parameters
    ----------
    *words : str
        Arguments of Python.
    timeout : float, optional
        Seconds after which the process is ended.

    Returns
    -------
    str
        Its standard output.
    Cost
        What it took.

    Raises
    ------
    RefusalError
        Where it fails, with its last line, or does not end in time.
    """
    environment = os.environ | {"PERCEPT_CACHE": "off"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    process = subprocess.Popen(
        [sys.executable, "-S", "-c", _START, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,
    )
    try:
        output, errors = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        raise RefusalError(f"not finished after {timeout:g} s.") from None
    finally:
        # Also after an interrupt, which does not reach a session of its own.
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    *lines, last = errors.strip().splitlines()
    if process.returncode:
        raise RefusalError(f"{' '.join(words[:3])} failed: {lines[-1] if lines else last}")
    wall, processor, memory = map(float, last.split())
    return output, Cost(wall, processor, memory / _MB)


def in_a_process(
    function: Callable[..., Any], *arguments: object, timeout: float | None = None
) -> tuple[Any, Cost]:
    """Call a function of a module in a process of its own; what it returns must be JSON.

    Parameters
    ----------
    function : callable
        Found by its module and name.
    *arguments : object
        Of the function, as JSON has them.
    timeout : float, optional
        Seconds after which the process is ended.

    Returns
    -------
    object
        What the function returned.
    Cost
        What the process took.
    """
    task = json.dumps([f"{function.__module__}:{function.__name__}", arguments])
    output, cost = run_python("-m", __name__, task, timeout=timeout)
    # Some libraries print to standard output, before the result.
    return json.loads(output.splitlines()[-1]), cost


def _main(task: str) -> None:
    """Call the function of a task, and print what it returns."""
    name, arguments = json.loads(task)
    result = resolve_name(name)(*arguments)
    print(f"\n{json.dumps(result, default=np.ndarray.tolist)}")


if __name__ == "__main__":
    _main(sys.argv[1])
