"""Clusters for tests: threads of this process, and a scheduler with workers started by command."""

import contextlib
import logging
import os
import re
import signal
import subprocess
import sys
import time

import pytest

from percept.workers import connected

#: What dask leaves open or says of itself while it starts and ends.
QUIET = pytest.mark.filterwarnings(
    "default::DeprecationWarning",
    "ignore::ResourceWarning",
    "ignore::pytest.PytestUnraisableExceptionWarning",
)
_LOOPBACK = ["--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0"]
_UNBUFFERED = {**os.environ, "PYTHONUNBUFFERED": "1"}


@contextlib.contextmanager
def in_threads():
    """Client of a dask cluster in this process: two workers of one thread."""
    import distributed

    with (
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=False,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


@contextlib.contextmanager
def scheduler(folder, workers):
    """Process and address of a scheduler on loopback, with workers that are processes of their
    own."""
    process = _start(folder / "scheduler", "scheduler", "--port", "0", *_LOOPBACK)
    running = [process]
    try:
        address = _address(folder / "scheduler")
        for number in range(workers):
            running.append(
                _start(folder / f"{number}", "worker", address, "--nthreads", "1", *_LOOPBACK)
            )
        if workers:
            with connected(address) as client:
                client.wait_for_workers(workers, timeout=60)
        yield process, address
    finally:
        for one in reversed(running):
            one.send_signal(signal.SIGINT)
        for one in running:
            try:
                one.wait(20)
            except subprocess.TimeoutExpired:
                one.kill()
                one.wait()


def _start(log, *arguments):
    with log.open("w") as file:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *arguments], stderr=file, env=_UNBUFFERED
        )


def _address(log):
    """Where a scheduler just started listens, as it says itself."""
    for _ in range(600):
        if found := re.search(r"Scheduler at:\s+(tcp://127\.0\.0\.1:\d+)", log.read_text()):
            return found[1]
        time.sleep(0.1)
    raise AssertionError(f"no address in: {log.read_text()}")
