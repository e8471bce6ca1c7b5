"""Jobs on dask: threads here, processes here that die, and a scheduler that is lost."""

import os
import re
import signal
import threading
from pathlib import Path

import pytest

distributed = pytest.importorskip("distributed", reason="needs the extra percept[cluster]")

from percept.errors import RefusalError  # noqa: E402 - only where distributed is installed
from percept.workers import InProcess, Job, OnCluster, connected  # noqa: E402
from percept.workers.on_cluster import call_checked  # noqa: E402
from tests.workers.clusters import QUIET, in_threads, scheduler  # noqa: E402

pytestmark = QUIET


def inverse(x):
    return 1 / x


def numbered(arguments):
    return [Job(f"job {number}", argument) for number, argument in enumerate(arguments)]


def by_key(answers):
    return {answer.job.key: answer.result for answer in answers}


def test_answers_are_those_of_one_process_and_errors_are_their_jobs_own():
    jobs = numbered([1, 3, 0, 7, 11])
    with in_threads() as client:
        found = by_key(OnCluster(client).map(inverse, jobs))
    wanted = by_key(InProcess().map(inverse, jobs))
    assert isinstance(found.pop("job 2"), ZeroDivisionError)
    assert isinstance(wanted.pop("job 2"), ZeroDivisionError)
    assert found == wanted


def test_no_more_than_two_jobs_per_thread_are_taken_ahead():
    taken, most = 0, 0

    def jobs():
        nonlocal taken
        for job in numbered(range(1, 30)):
            taken += 1
            yield job

    with in_threads() as client:
        for back, _ in enumerate(OnCluster(client).map(inverse, jobs())):
            most = max(most, taken - back)
    assert taken == 29
    assert most == 4


def dies(path):
    """End the worker by force as often as the file of that name has characters left."""
    lives = Path(path).read_text()
    if lives:
        Path(path).write_text(lives[1:])
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def test_workers_that_die_cost_no_answer_and_one_that_always_dies_only_its_own(tmp_path):
    from dask import config

    lives = {"once": "x", "always": 9 * "x", **{f"never {i}": "" for i in range(6)}}
    jobs = []
    for name, left in lives.items():
        (tmp_path / name).write_text(left)
        jobs.append(Job(name, str(tmp_path / name)))
    with config.set({"distributed.scheduler.allowed-failures": 1}), connected(workers=2) as client:
        found = by_key(OnCluster(client).map(dies, jobs))
    always = found.pop("always")
    assert isinstance(always, distributed.KilledWorker)
    assert found == dict.fromkeys(lives.keys() - {"always"}, "alive")


_started, _go_on = threading.Semaphore(0), threading.Event()


def waits(x):
    _started.release()
    _go_on.wait(1.0)  # two workers: a third attempt begins when the first ends
    return x


@pytest.mark.parametrize(("losses", "result"), [(1, "5"), (2, "5"), (3, "lost 3 times with the worker")])
def test_a_result_lost_with_its_worker_is_asked_for_twice_more(losses, result):
    """Cancelling is what dask does for a client whose result is nowhere any more."""
    _go_on.clear()
    with in_threads() as client:

        def lose():
            for _ in range(losses):
                _started.acquire()
                client.cancel([distributed.Future(key, client) for key in client.futures])
            _go_on.set()

        thread = threading.Thread(target=lose)
        thread.start()
        (answer,) = OnCluster(client).map(waits, [Job("a", 5)])
        thread.join()
    while _started.acquire(blocking=False):
        pass
    assert result in str(answer.result)


def test_a_worker_with_other_code_does_not_answer():
    with pytest.raises(RuntimeError, match=r"another version of percept .* give both the same"):
        call_checked("percept 0.0.0", inverse, 1)


def test_a_lost_scheduler_is_said(tmp_path):
    with scheduler(tmp_path, workers=0) as (process, address), connected(scheduler=address) as client:
        threading.Timer(0.5, process.kill).start()  # no worker is there: the job waits
        with pytest.raises(RefusalError, match=r"the scheduler was lost.*What is finished is kept"):
            list(OnCluster(client).map(inverse, numbered([1])))
    assert re.search("Scheduler at", (tmp_path / "scheduler").read_text())
