"""A second process draws the same figures, and is gone when it is no longer needed."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from percept.errors import UsageError
from percept.report.artist import Artist
from percept.report.figures.canvas import Drawing, panels
from percept.report.figures.catalogue import drawings
from percept.report.plates import drawn

ABANDONED = """
import os, signal
from percept.report.artist import Artist

with Artist(("svg",), processes=2) as artist:
    print(artist.process.pid, flush=True)
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


def test_the_other_process_draws_the_same_bytes(classical):
    chosen = drawings(classical)[:3]
    with Artist(("svg", "png"), processes=2) as artist:
        assert artist.process is not None
        pid = artist.process.pid
        begun = [artist.draw(drawing) for drawing in chosen]
        found = [figure() for figure in begun]
        assert artist.answered == len(chosen)
    assert found == [drawn(drawing, ("svg", "png")) for drawing in chosen]
    assert set(found[0].files) == {f"{chosen[0].name}.svg", f"{chosen[0].name}.png"}
    assert not running(pid)


def test_a_killed_process_costs_time_and_nothing_else(classical):
    first, second, *_ = drawings(classical)
    with Artist(("svg",), processes=2) as artist:
        assert artist.draw(first)() == drawn(first, ("svg",))
        assert artist.process is not None
        artist.process.kill()
        assert artist.draw(second)() == drawn(second, ("svg",))
        assert artist.answered == 1


def test_one_core_draws_by_itself(classical):
    drawing = drawings(classical)[0]
    with Artist(("svg",), processes=1) as artist:
        assert artist.process is None
        assert artist.draw(drawing)() == drawn(drawing, ("svg",))


def test_what_cannot_be_sent_is_drawn_here(classical):
    here = Drawing("one", "One", "None.", (40.0, 30.0), lambda figure: panels(figure)[0].plot([1, 2]))
    with Artist(("svg",), processes=2) as artist:
        assert b"<path" in artist.draw(here)().files["one.svg"]
        after = drawings(classical)[0]
        assert artist.draw(after)() == drawn(after, ("svg",))
        assert artist.answered == 1


def test_errors_are_those_of_drawing_here(classical):
    with (
        Artist(("eps",), processes=2) as artist,
        pytest.raises(UsageError, match="figures come as svg, pdf, png"),
    ):
        artist.draw(drawings(classical)[0])()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads the table of processes")
def test_it_does_not_outlive_a_killed_maker():
    killed = subprocess.run([sys.executable, "-c", ABANDONED], capture_output=True, text=True, check=False)
    assert killed.returncode == -9
    assert ended(int(killed.stdout))
