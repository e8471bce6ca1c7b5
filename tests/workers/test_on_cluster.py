"""Jobs on dask: threads here, processes here that die, and a scheduler that is lost."""

import re
import threading
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
