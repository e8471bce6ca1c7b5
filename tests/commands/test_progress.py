"""What a command shows on a terminal while it works: run on a real one."""

import os
import pty
import re
import subprocess
import sys

import pytest

from percept.commands.analysis import Working
from percept.inference.sampling.gate import Progress
from reports import dataset

SESSIONS = str(dataset("hbfd_sessions.csv"))

SAMPLING = """
import time
from percept.commands.analysis import Working
from percept.inference.sampling.gate import Progress
with Working("fitting", shown=True) as working:
    time.sleep(0.4)
    working(Progress(24, 480, float("nan"), 0.01, 191.0, "a larger tolerance"))
    time.sleep(0.4)
    working(Progress(240, 480, 0.0123, 0.01, 95.0, "a larger tolerance"))
    time.sleep(0.4)
    print("on standard output")
"""
COMMAND = """
import sys
from percept.cli import main
sys.exit(main(sys.argv[1:]))
"""


def on_a_terminal(script, *words, columns=100):
    """Run a script whose standard error is a terminal; what it printed, and what was shown."""
    here, there = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": str(columns)}
    done = subprocess.Popen(
        [sys.executable, "-c", script, *words],
        stdout=subprocess.PIPE,
        stderr=there,
        env=environment,
    )
    os.close(there)
    shown = b""
    while True:
        try:
            part = os.read(here, 4096)
        except OSError:  # Linux says so once the other end is closed
            break
        if not part:
            break
        shown += part
    os.close(here)
    printed = done.communicate(timeout=60)[0].decode()
    return done.returncode, printed, re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.decode())


COUNTED = """
import time
from percept.commands.analysis import Working
with Working("reading", shown=True) as working:
    for done in (501, 502):  # 500 were finished before
        time.sleep(0.3)
        working.show(f"{done} of 1000 studies, 3 refused or failed", done, 1000)
    time.sleep(0.6)
"""


def test_a_long_command_tells_the_time_left_by_its_own_rate():
    _, printed, shown = on_a_terminal(COUNTED)
    assert printed == ""
    last = shown.rpartition("502 of 1000 studies, 3 refused or failed")[2]
    # The second study took 0.3 s or more, so 498 take 149 s; a rate over all 502 would promise
    # under 1 s.
    minutes, seconds = re.search(r"0:(\d\d):(\d\d)\s+left", last).groups()
    assert 60 * int(minutes) + int(seconds) >= 149


@pytest.mark.parametrize("columns", [40, 100])
def test_shows_what_it_does_and_then_the_sampler(columns):
    code, printed, shown = on_a_terminal(SAMPLING, columns=columns)
    assert code == 0, shown
    assert printed == "on standard output\n"
    assert "fitting" in shown
    assert "sampling: 240/480 steps" in shown
    if columns >= 80:
        assert "error 1.23%, asked 1.00%" in shown
        assert "left" in shown


@pytest.mark.parametrize(
    ("seconds", "said"), [(59.0, ""), (61.0, "about 1 min"), (191.0, "about 3 min")]
)
def test_a_long_run_says_once_how_long_it_takes_and_what_is_quicker(seconds, said, capsys):
    with Working("fitting", shown=True) as working:
        for steps in (24, 120):
            working(
                Progress(
                    steps, 480, float("nan"), 0.01, seconds, "[inference] tolerance above 0.01"
                )
            )
    told = capsys.readouterr().err
    wanted = f"percept: sampling takes {said}. Quicker: [inference] tolerance above 0.01.\n"
    assert told == (wanted if said else "")


STAGES = """
import time
from percept.commands.analysis import Working
with Working("reporting", shown=True) as working:
    working.stage("boundaries")
    time.sleep(2.6)
    working.stage("coupling")
    time.sleep(0.5)
"""


def test_a_stage_is_shown_on_a_terminal_and_said_elsewhere_once_it_is_slow():
    # Both wait most of the time, so they wait together.
    elsewhere = subprocess.Popen(
        [sys.executable, "-c", STAGES], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    _, _, shown = on_a_terminal(STAGES)
    assert re.search(r"boundaries\s+0:00:02", shown)
    assert "coupling" in shown
    assert elsewhere.communicate(timeout=60) == ("", "percept: boundaries …\n")
    assert elsewhere.returncode == 0


def test_nothing_is_shown_where_not_wanted(tmp_path):
    words = ["fit", SESSIONS, "--method", "classical", "--quiet", "--out", tmp_path]
    code, _, shown = on_a_terminal(COMMAND, *map(str, words))
    assert (code, shown) == (0, "")
