"""Other processes give the same answers, and are gone when they are no longer needed."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from percept.processes import Processes

ABANDONED = """
import os, signal
from percept.processes import Processes

with Processes(2) as processes:
    print(processes.others[0].pid, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    # Nobody may be there to collect what is left of it.
    return state != "Z"


def ended(pid: int) -> bool:
    for _ in range(600):
        if not running(pid):
            return True
        time.sleep(0.05)
    return False


def test_asked_elsewhere():
    with Processes(2) as processes:
        (other,) = processes.others
        assert processes.parts == 2
        begun = [processes.ask(os.getpid), processes.ask(math.hypot, 3.0, 4.0)]
        assert [answer() for answer in begun] == [other.pid, 5.0]
        assert processes.answered == 2
    assert not running(other.pid)
    assert processes.parts == 1


def test_several_calls_are_answered_in_order_by_all():
    """Whoever is done takes the next: of calls that wait, no process makes all."""
    with Processes(3) as processes:
        assert processes(math.sqrt, [(float(n * n),) for n in range(40)]) == [float(n) for n in range(40)]
        assert processes(math.sqrt, []) == []
        processes.answered = 0
        assert processes(time.sleep, [(0.2,)] * 6) == [None] * 6
        assert 2 <= processes.answered <= 5


def test_a_killed_process_costs_time_and_nothing_else():
    with Processes(2) as processes:
        assert processes.ask(math.factorial, 5)() == 120
        processes.others[0].kill()
        assert processes.ask(math.factorial, 6)() == 720
        assert processes(math.factorial, [(7,), (8,), (9,)]) == [5040, 40320, 362880]
        assert processes.answered == 1


def test_one_core_works_by_itself():
    with Processes(1) as processes:
        assert processes.others == []
        assert processes.ask(os.getpid)() == os.getpid()
        assert processes(math.sqrt, [(4.0,), (9.0,)]) == [2.0, 3.0]


def test_what_cannot_be_sent_or_sent_back_is_worked_on_here():
    with Processes(2) as processes:
        assert processes.ask(lambda: 7)() == 7
        assert [f() for f in processes(_maker, [(1,), (2,)])] == [1, 2]
        assert processes.answered == 0
        assert processes.ask(math.sqrt, 4.0)() == 2.0
        assert processes.answered == 1


class Odd:
    """What says that it cannot be pickled in a way of its own."""

    def __init__(self, error):
        self._error = error

    def __reduce__(self):
        raise self._error


def _odd(kind):
    return Odd(kind("no"))


@pytest.mark.parametrize("kind", [ValueError, OSError, RuntimeError])
def test_an_answer_that_cannot_be_pickled_does_not_end_the_other_process(kind):
    with Processes(2) as processes:
        assert isinstance(processes.ask(_odd, kind)(), Odd)
        assert processes.ask(type, Odd(kind("no")))() is Odd
        assert processes.ask(os.getpid)() == processes.others[0].pid


def _maker(value):
    return lambda: value


def test_errors_are_those_of_working_here():
    with Processes(2) as processes:
        asked = processes.ask(math.sqrt, -1.0)
        with pytest.raises(ValueError, match=r"math domain error|nonnegative input"):
            asked()
        with pytest.raises(ValueError, match=r"math domain error|nonnegative input"):
            processes(math.sqrt, [(1.0,), (-1.0,)])


def test_what_others_print_does_not_come_between_answers():
    with Processes(2) as processes:
        assert processes.ask(print, "not an answer")() is None
        assert processes.ask(os.write, 1, b"nor this")() == len(b"nor this")
        assert processes.answered == 2


def test_modules_are_imported_before_the_first_call():
    with Processes(2, preload=["colorsys"]) as processes:
        assert "colorsys" in processes.ask(_modules)()
        assert processes.answered == 1
    with Processes(2, preload=["no_such_module"]) as processes:
        assert processes.ask(math.sqrt, 4.0)() == 2.0
        assert processes.answered == 0


def _modules():
    return sorted(sys.modules)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads the table of processes")
def test_they_do_not_outlive_a_killed_asker():
    killed = subprocess.run([sys.executable, "-c", ABANDONED], capture_output=True, text=True, check=False)
    assert killed.returncode == -9
    assert ended(int(killed.stdout))
