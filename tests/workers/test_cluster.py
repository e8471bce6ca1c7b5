import sys
import time

import pytest

from percept.errors import UsageError
from percept.workers import connected, in_process, on_cluster, open_mapper
from tests.workers.clusters import QUIET

pytestmark = QUIET


def test_arguments_are_taken_when_the_result_before_is_handed_back():
    seen = []

    def numbers():
        for number in range(3):
            seen.append(f"take {number}")
            yield number

    for number, result in in_process(lambda number: number**2, numbers()):
        seen.append(f"{number}: {result}")
    assert seen == ["take 0", "0: 0", "take 1", "1: 1", "take 2", "2: 4"]


def test_an_error_is_its_argument_s_and_the_others_go_on():
    found = dict(in_process(lambda x: 1 / x, [2, 0, 4]))
    assert (found[2], found[4]) == (0.5, 0.25)
    assert isinstance(found[0], ZeroDivisionError)


def test_an_interruption_is_no_result():
    def interrupted(x):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        next(in_process(interrupted, [1]))


def opened(*arguments, **options):
    open_mapper(*arguments, **options).__enter__()


@pytest.mark.parametrize(
    ("workers", "scheduler", "message"),
    [
        (0, None, r"--workers = 0: must be at least 1"),
        (
            1,
            "tcp://127.0.0.1:1",
            "a scheduler has workers of its own. Give --workers or --scheduler",
        ),
    ],
)
def test_wrong_usage(workers, scheduler, message):
    with pytest.raises(UsageError, match=message):
        opened(workers, scheduler)


def test_without_dask_one_worker_works_and_more_name_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with open_mapper(1) as mapper:
        assert list(mapper(abs, [-2])) == [(-2, 2)]
    assert mapper is in_process
    for workers, scheduler in ((2, None), (None, "tcp://127.0.0.1:1")):
        with pytest.raises(
            UsageError, match=r"not installed.*percept\[cluster\], or give --workers 1"
        ):
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
        # Longer than a second, dask's cycle of keeping profiles.
        assert sorted(on_cluster(client)(spin, [1.5, 1.0])) == [(1.0, 1.0), (1.5, 1.5)]
        assert client.profile()["count"] == 0


def test_no_scheduler_at_the_address_is_said(monkeypatch):
    pytest.importorskip("distributed", reason="needs the extra percept[cluster]")
    monkeypatch.setattr("percept.workers._SECONDS", 1.0)
    with pytest.raises(
        UsageError, match=r"tcp://127.0.0.1:1.*no scheduler answers.*dask worker ADDRESS"
    ):
        connected(scheduler="tcp://127.0.0.1:1").__enter__()
