import sys
import time

import pytest

from percept.errors import UsageError
from percept.workers import InProcess, Job, OnCluster, connected, open_mapper
from tests.workers.clusters import QUIET

pytestmark = QUIET


def opened(*arguments, **options):
    open_mapper(*arguments, **options).__enter__()


@pytest.mark.parametrize(
    ("workers", "scheduler", "message"),
    [
        (0, None, r"--workers = 0: must be at least 1"),
        (1, "tcp://127.0.0.1:1", "a scheduler has workers of its own. Give --workers or --scheduler"),
    ],
)
def test_wrong_usage(workers, scheduler, message):
    with pytest.raises(UsageError, match=message):
        opened(workers, scheduler)


def test_without_dask_one_worker_works_and_more_name_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with open_mapper(1) as mapper:
        (answer,) = mapper.map(abs, [Job("a", -2)])
    assert isinstance(mapper, InProcess)
    assert answer.result == 2
    for workers, scheduler in ((2, None), (None, "tcp://127.0.0.1:1")):
        with pytest.raises(UsageError, match=r"not installed.*percept\[cluster\], or give --workers 1"):
            opened(workers, scheduler)


def spin(seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass
    return seconds


def test_workers_of_this_machine_are_processes_with_one_thread_each_and_keep_no_records():
    pytest.importorskip("distributed", reason="needs the extra percept[cluster]")
    with connected(workers=2) as client:
        assert sorted(client.nthreads().values()) == [1, 1]
        blas = client.run(lambda: __import__("os").environ["OPENBLAS_NUM_THREADS"])
        assert set(blas.values()) == {"1"}
        jobs = [Job("a", 1.5), Job("b", 1.0)]  # longer than a second, dask's cycle of keeping profiles
        assert sorted(answer.result for answer in OnCluster(client).map(spin, jobs)) == [1.0, 1.5]
        assert client.profile()["count"] == 0


def test_no_scheduler_at_the_address_is_said(monkeypatch):
    pytest.importorskip("distributed", reason="needs the extra percept[cluster]")
    monkeypatch.setattr("percept.workers.cluster._SECONDS", 1.0)
    with pytest.raises(UsageError, match=r"tcp://127.0.0.1:1.*no scheduler answers.*dask worker ADDRESS"):
        connected(scheduler="tcp://127.0.0.1:1").__enter__()
