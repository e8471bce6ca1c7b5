"""Jobs on dask: threads here, processes here that die, and a scheduler that is lost."""

import os
import re
import signal
import threading
import time
import types
from pathlib import Path

import pytest

distributed = pytest.importorskip("distributed", reason="needs the extra percept-haptics[cluster]")

from percept.errors import RefusalError  # noqa: E402 - only where distributed is installed
from percept.workers import (  # noqa: E402
    connected,
    on_cluster,
    require_same_code,
)
from tests.workers.clusters import QUIET, in_threads, scheduler  # noqa: E402

pytestmark = QUIET


def inverse(x):
    return 1 / x


def test_no_more_than_two_arguments_per_thread_are_taken_ahead():
    taken, most = 0, 0

    def numbers():
        nonlocal taken
        for number in range(1, 30):
            taken += 1
            yield number

    with in_threads() as client:
        for back, _ in enumerate(on_cluster(client)(inverse, numbers())):
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


def given_up(path):
    """Raise what dask does when several workers died with a job, as often as the file has
    characters."""
    lives = Path(path).read_text()
    if lives:
        Path(path).write_text(lives[1:])
        raise distributed.KilledWorker("job", types.SimpleNamespace(address="tcp://gone"), 3)
    return "alive"


def test_what_dask_gives_up_is_tried_once_more_by_itself_at_the_end(tmp_path):
    """Two characters outlast dask's own second try, nine also percept's."""
    for name, lives in {"waited": "xx", "culprit": 9 * "x", "never": ""}.items():
        (tmp_path / name).write_text(lives)
    paths = [str(tmp_path / name) for name in ("waited", "culprit", "never")]
    with in_threads() as client:
        found = list(on_cluster(client)(given_up, paths))
    results = {Path(path).name: result for path, result in found}
    assert next(iter(results)) == "never"
    assert isinstance(results.pop("culprit"), distributed.KilledWorker)
    assert results == {"never": "alive", "waited": "alive"}


@pytest.mark.evidence
def test_workers_that_die_cost_no_result_and_one_that_always_dies_only_its_own(tmp_path):
    from dask import config

    lives = {"once": "x", "always": 9 * "x", **{f"never {i}": "" for i in range(6)}}
    for name, left in lives.items():
        (tmp_path / name).write_text(left)
    with (
        config.set({"distributed.scheduler.allowed-failures": 1}),
        in_threads(processes=True) as client,
    ):
        found = {
            Path(path).name: result
            for path, result in on_cluster(client)(dies, [str(tmp_path / name) for name in lives])
        }
    assert isinstance(found.pop("always"), distributed.KilledWorker)
    assert found == dict.fromkeys(lives.keys() - {"always"}, "alive")


def worker_of(seconds):
    """Take a while and say which process it was."""
    time.sleep(seconds)
    return os.getpid()


@pytest.mark.evidence
def test_a_worker_lost_with_what_it_had_finished_costs_no_result():
    """While one result is looked at the others are finished; then a worker that holds one dies."""
    with in_threads(processes=True) as client:
        results = on_cluster(client)(worker_of, [0.0, 0.1, 0.2, 0.3])
        first, worker = next(results)
        time.sleep(1.0)
        os.kill(worker, signal.SIGKILL)
        rest = dict(results)
    assert {first, *rest} == {0.0, 0.1, 0.2, 0.3}
    assert all(isinstance(result, int) for result in rest.values())


def fails_once(path):
    """Fail while the file of that name is there, and remove it."""
    Path(path).unlink()
    raise OSError("no space left")


def test_a_job_that_ends_in_an_error_is_given_out_once_more(tmp_path):
    (tmp_path / "full").write_text("")
    with in_threads() as client:
        ((_, result),) = on_cluster(client)(fails_once, [str(tmp_path / "full")])
    assert isinstance(result, FileNotFoundError)


def test_a_worker_with_other_code_is_refused(monkeypatch):
    versions = iter(["here", "there"])
    monkeypatch.setattr("percept.workers.numbers_version", lambda _: next(versions))
    with (
        in_threads() as client,
        pytest.raises(RefusalError, match=r"another version of percept.*the same code"),
    ):
        require_same_code(client)


def test_a_lost_scheduler_is_said(tmp_path):
    with (
        scheduler(tmp_path, workers=0) as (process, address),
        connected(address, patience=3.0) as client,
    ):
        threading.Timer(0.5, process.kill).start()  # no worker is there: the job waits
        with pytest.raises(RefusalError, match=r"the scheduler was lost.*What is finished is kept"):
            list(on_cluster(client)(inverse, [1]))
    assert re.search("Scheduler at", (tmp_path / "scheduler").read_text())
