"""Processes of this machine: real ones, which die too."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor
from pathlib import Path

import pytest

from percept.workers import beside, cores, in_process, processes


def inverse(x):
    return 1 / x


@pytest.fixture
def two():
    """Two workers."""
    return processes(2)


def test_results_are_those_of_one_process_and_errors_are_their_arguments_own(two):
    """No more arguments than there are processes are taken ahead."""
    taken, most = 0, 0

    def numbers():
        nonlocal taken
        for number in range(29):
            taken += 1
            yield number

    found = {}
    for number, result in two(inverse, numbers()):
        most = max(most, taken - len(found))
        found[number] = result
    assert taken == 29
    assert most == 2
    wanted = dict(in_process(inverse, range(29)))
    error = found.pop(0)
    assert isinstance(error, ZeroDivisionError)
    assert "in inverse" in str(error.__cause__)
    assert isinstance(wanted.pop(0), ZeroDivisionError)
    assert found == wanted


def dies(path):
    """End the worker by force as often as the file of that name has characters left."""
    lives = Path(path).read_text()
    if lives:
        Path(path).write_text(lives[1:])
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def test_workers_that_die_cost_no_result_and_one_that_always_dies_only_its_own(two, tmp_path):
    lives = {"once": "x", "always": 9 * "x", "never": "", "nor": ""}
    for name, left in lives.items():
        (tmp_path / name).write_text(left)
    found = {
        Path(path).name: result
        for path, result in two(dies, [str(tmp_path / name) for name in lives])
    }
    assert isinstance(found.pop("always"), BrokenExecutor)
    assert found == dict.fromkeys(lives.keys() - {"always"}, "alive")


def unsendable(kind):
    """Return or raise what no other process can make again."""
    if kind == "result":
        return lambda: None
    if kind == "error":
        raise AwkwardError("first", "second")
    return kind


class AwkwardError(Exception):
    def __init__(self, first, second):
        super().__init__(first)


def test_what_cannot_be_sent_is_the_error_of_its_argument(two):
    lock = threading.Lock()
    found = dict(two(unsendable, ["result", lock, "error", "fine"]))
    assert "pickle" in str(found["result"])
    # Such an error cannot be made again here, which ends the pool.
    assert isinstance(found["error"], BrokenExecutor)
    assert isinstance(found[lock], TypeError)
    assert found["fine"] == "fine"


def late(seconds):
    time.sleep(seconds)
    return seconds


def test_a_call_given_up_waits_for_no_answer(two):
    results = two(late, [0.0, 60.0])
    assert next(results) == (0.0, 0.0)
    start = time.monotonic()
    results.close()
    assert time.monotonic() - start < 20.0


def threads(_):
    return os.environ["OPENBLAS_NUM_THREADS"], os.getpid()


def test_each_worker_computes_in_one_thread():
    before = dict(os.environ)
    found = dict(processes(64)(threads, range(2)))
    assert {variable for variable, _ in found.values()} == {"1"}
    assert os.getpid() not in {worker for _, worker in found.values()}
    assert dict(os.environ) == before


UNGUARDED = """
from percept.workers import processes
print(list(processes(2)(abs, [-1])))
"""
GUARDED = """
from percept.workers import processes
if __name__ == "__main__":
    print(list(processes(2)(abs, [-1])))
"""


def test_a_script_that_starts_workers_wherever_it_is_read_is_told_so(tmp_path):
    (tmp_path / "script.py").write_text(UNGUARDED)
    ran = subprocess.run(
        [sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 1
    assert "a worker process ended before it could work" in ran.stderr
    assert '__name__ == "__main__"' in ran.stderr
    (tmp_path / "script.py").write_text(GUARDED)
    ran = subprocess.run(
        [sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=True
    )
    assert ran.stdout == "[(-1, 1)]\n"


LOST = """
import os, signal, sys
from percept.workers import processes
for _ in processes(2)(os.getpgid, [0, 0]):
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="processes are told by their group")
def test_workers_end_with_the_process_that_started_them():
    ran = subprocess.Popen([sys.executable, "-c", LOST], start_new_session=True)
    assert ran.wait(60) == -signal.SIGKILL
    for _ in range(100):
        try:
            os.killpg(ran.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    raise AssertionError("workers are left")


two_cores = pytest.mark.skipif(cores() < 2, reason="one core: no copy would gain anything")


@two_cores
def test_a_copy_knows_what_this_process_knows():
    known = {"pid": os.getpid(), "square": lambda x: x * x}
    with beside(lambda: lambda x: (os.getpid(), known["pid"], known["square"](x))) as begin:
        copy, here, square = begin(3)()
    assert copy != here == os.getpid()
    assert square == 9


@two_cores
@pytest.mark.parametrize("end", [lambda: os.kill(os.getpid(), signal.SIGKILL), lambda: 1 / 0])
def test_what_a_copy_leaves_undone_is_done_here(end):
    here = os.getpid()

    def work():
        if os.getpid() != here:
            end()
        return os.getpid()

    with beside(lambda: work) as begin:
        assert begin()() == here


@two_cores
def test_a_copy_ends_with_what_it_was_for(tmp_path):
    started = tmp_path / "pid"

    def work():
        started.write_text(str(os.getpid()))
        time.sleep(60)

    def interrupted():
        with beside(lambda: work) as begin:
            begin()
            while not started.exists() or not started.read_text():
                time.sleep(0.01)
            raise KeyboardInterrupt

    before = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert time.monotonic() - before < 30
    with pytest.raises(ProcessLookupError):
        os.kill(int(started.read_text()), 0)
