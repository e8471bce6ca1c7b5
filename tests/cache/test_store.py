import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from percept.cache import (
    PosteriorCache,
    cache_folder,
    decode,
    encode,
)


@pytest.fixture
def cache(tmp_path):
    return PosteriorCache(tmp_path / "kept", limit=10**9)


def store(cache, number, run):
    """Have a cache keep a run, and return the name of its file."""
    before = set(names(cache))
    cache.keep((number,), run)
    (name,) = set(names(cache)) - before
    return name


def names(cache):
    return [path.name for path in cache.entries()]


def test_a_run_comes_back_in_every_bit(run):
    found = decode(encode(run, "asked"), "asked")
    for name in ("points", "components"):
        assert getattr(found, name).tobytes() == getattr(run, name).tobytes()
    for name in ("value", "scale", "errors", "times", "rhats"):
        assert getattr(found.estimates, name).tobytes() == getattr(run.estimates, name).tobytes()
    assert found.estimates.names == run.estimates.names
    assert found.gate == run.gate
    assert (found.steps, found.stride, found.settings) == (run.steps, run.stride, run.settings)
    assert encode(found, "asked") == encode(run, "asked")


def test_an_entry_of_another_question_is_not_believed(cache, run, caplog):
    first = store(cache, 0, run)
    second = store(cache, 1, run)
    (cache.folder / first).write_bytes((cache.folder / second).read_bytes())
    assert cache.find((0,)) is None
    assert "it answers another question" in caplog.text


def test_a_kept_run_is_found_by_what_it_was_asked(cache, run):
    assert cache.find((1, "a")) is None
    cache.keep((1, "a"), run)
    np.testing.assert_array_equal(cache.find((1, "a")).points, run.points)
    assert cache.find((2, "a")) is None


@pytest.mark.parametrize("harm", ["torn", "flipped", "empty", "foreign"])
def test_a_damaged_entry_is_said_and_replaced(cache, run, caplog, harm):
    cache.keep(("x",), run)
    (path,) = cache.folder.iterdir()
    data = path.read_bytes()
    middle = len(data) // 2
    flipped = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
    path.write_bytes(
        {"torn": data[:-100], "flipped": flipped, "empty": b"", "foreign": b"PAR1"}[harm]
    )
    assert cache.find(("x",)) is None
    assert "computed again" in caplog.text
    cache.keep(("x",), run)
    assert path.read_bytes() == data


def test_the_longest_unused_goes_first(cache, run):
    cache.limit = 3 * len(encode(run, "asked")) + 1000
    first, second, third = (store(cache, number, run) for number in range(3))
    # Clocks of files may not tick between two uses.
    for age, name in enumerate([first, second, third]):
        os.utime(cache.folder / name, (age, age))
    assert names(cache) == [first, second, third]
    assert cache.find((0,)) is not None
    cache.keep((3,), run)
    kept = names(cache)
    assert kept[0] == third
    assert first in kept
    assert second not in kept


def test_clear_removes_entries_and_nothing_else(cache, run):
    store(cache, 0, run)
    store(cache, 1, run)
    (cache.folder / "mine.txt").write_text("kept")
    assert cache.clear() == 2
    assert [path.name for path in cache.folder.iterdir()] == ["mine.txt"]
    assert PosteriorCache(cache.folder / "nowhere").clear() == 0


FULL = """
import resource, sys
sys.path.insert(0, sys.argv[2])
import logging, pickle
from pathlib import Path
from percept.cache import PosteriorCache, decode
run = decode(Path(sys.argv[1]).read_bytes(), "asked")
cache = PosteriorCache(Path(sys.argv[3]))
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
cache.keep((1,), run)
print(sorted(path.name for path in Path(sys.argv[3]).iterdir()))
"""


TWO = """
import sys
from pathlib import Path
from percept.cache import PosteriorCache, decode, encode
data = Path(sys.argv[1]).read_bytes()
run = decode(data, "asked")
cache = PosteriorCache(Path(sys.argv[2]), limit=3 * len(data) + 1000)
found = 0
for turn in range(200):
    asked = ((turn // 2 * int(sys.argv[3])) % 6,)  # twice each: a process alone finds some too
    kept = cache.find(asked)
    if kept is None:
        cache.keep(asked, run)
    else:
        assert encode(kept, "asked") == data
        found += 1
print(found)
"""


def test_two_processes_that_store_load_and_evict_at_once_never_see_a_torn_entry(tmp_path, run):
    (tmp_path / "entry").write_bytes(encode(run, "asked"))
    arguments = [sys.executable, "-c", TWO, str(tmp_path / "entry"), str(tmp_path / "c")]
    running = [
        subprocess.Popen(
            [*arguments, step], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for step in ("1", "5")
    ]
    for process in running:
        out, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
        assert int(out) > 0
        assert err == ""
    left = list((tmp_path / "c").iterdir())
    assert 1 <= len(left) <= 4  # two evicting at once may each keep their own
    for path in left:
        assert not path.name.startswith(".")
        decode(path.read_bytes(), path.stem)


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"PERCEPT_CACHE": "/there"}, Path("/there")),
        ({"PERCEPT_CACHE": "off"}, None),
        ({"PERCEPT_CACHE": "", "XDG_CACHE_HOME": "/xdg"}, Path("/xdg/percept")),
        ({"PERCEPT_CACHE": "", "XDG_CACHE_HOME": "", "HOME": "/me"}, Path("/me/.cache/percept")),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="other systems keep caches elsewhere")
def test_where_the_cache_is(monkeypatch, variables, expected):
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert cache_folder() == expected


@pytest.mark.skipif(sys.platform == "win32", reason="limits of file sizes are POSIX")
def test_no_room_on_the_disk_is_said_and_leaves_nothing(tmp_path, run):
    (tmp_path / "entry").write_bytes(encode(run, "asked"))
    ran = subprocess.run(
        [
            sys.executable,
            "-c",
            FULL,
            str(tmp_path / "entry"),
            str(Path(__file__).parent),
            str(tmp_path / "c"),
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.strip() == "[]"
    assert "not kept for next time" in ran.stderr
    assert "File too large" in ran.stderr
