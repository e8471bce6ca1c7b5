import logging
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from percept.cache import PosteriorCache, cache_folder, cache_limit
from percept.cache.entry import decode, encode
from percept.errors import UsageError
from percept.files import exclusive

KEYS = [f"{i:064x}" for i in range(8)]


@pytest.fixture
def cache(tmp_path):
    return PosteriorCache(tmp_path / "kept", limit=10**9)


def names(cache):
    return sorted(path.name for path in cache.folder.iterdir())


def test_a_run_is_computed_once(cache, run):
    computed = []

    def compute():
        computed.append(1)
        return run

    first = cache.run((1, "a"), compute)
    second = cache.run((1, "a"), compute)
    assert len(computed) == 1
    assert first is run
    np.testing.assert_array_equal(second.points, run.points)
    cache.run((2, "a"), compute)
    assert len(computed) == 2


@pytest.mark.parametrize("harm", ["torn", "flipped", "empty", "foreign"])
def test_a_damaged_entry_is_said_discarded_and_computed_again(cache, run, caplog, harm):
    cache.run(("x",), lambda: run)
    (path,) = cache.folder.iterdir()
    data = path.read_bytes()
    flipped = data[:-1] + bytes([data[-1] ^ 1])
    path.write_bytes({"torn": data[:-100], "flipped": flipped, "empty": b"", "foreign": b"PAR1"}[harm])
    computed = []
    found = cache.run(("x",), lambda: computed.append(1) or run)
    assert computed
    assert found is run
    assert "damaged" in caplog.text
    assert "computed again" in caplog.text
    assert path.read_bytes() == data


def test_the_longest_unused_goes_first(cache, run):
    size = len(encode(run))
    cache.limit = 3 * size
    for key in KEYS[:3]:
        cache.store(key, run)
    assert cache.load(KEYS[0]) is not None
    cache.store(KEYS[3], run)
    assert [entry.key for entry in cache.entries()] == [KEYS[2], KEYS[0], KEYS[3]]


def test_a_clock_that_went_back_does_not_change_what_is_longest_unused(cache, run):
    for key in KEYS[:3]:
        cache.store(key, run)
    ahead = time.time_ns() + 10**18  # what was written before the clock went back by thirty years
    for key in KEYS[:3]:
        os.utime(cache.folder / f"{key}.run", ns=(ahead, ahead + KEYS.index(key)))
    cache.load(KEYS[0])
    cache.store(KEYS[3], run)
    assert [entry.key for entry in cache.entries()] == [KEYS[1], KEYS[2], KEYS[0], KEYS[3]]


def test_what_is_larger_than_the_cache_is_not_kept(tmp_path, run):
    cache = PosteriorCache(tmp_path / "kept", limit=100)
    assert cache.run((1,), lambda: run) is run
    assert cache.entries() == []


def test_leftovers_of_a_killed_process_go_when_nobody_writes(cache, run):
    cache.store(KEYS[0], run)
    leftover = cache.folder / f".{KEYS[1]}.run-abc.part"
    leftover.write_bytes(b"half")
    with exclusive(cache.folder):
        pass
    cache.store(KEYS[2], run)
    assert not leftover.exists()
    assert names(cache) == [f"{KEYS[0]}.run", f"{KEYS[2]}.run"]


def test_clear_removes_entries_and_nothing_else(cache, run):
    cache.store(KEYS[0], run)
    cache.store(KEYS[1], run)
    (cache.folder / "mine.txt").write_text("kept")
    assert cache.clear() == 2
    assert names(cache) == ["mine.txt"]
    assert PosteriorCache(cache.folder / "nowhere").clear() == 0


def test_a_folder_that_cannot_be_made_is_said_and_the_analysis_goes_on(tmp_path, run, caplog):
    (tmp_path / "file").write_text("")
    cache = PosteriorCache(tmp_path / "file" / "kept")
    assert cache.run((1,), lambda: run) is run
    assert "not kept for next time" in caplog.text


FULL = """
import resource, sys
sys.path.insert(0, sys.argv[2])
import logging, pickle
from pathlib import Path
from percept.cache import PosteriorCache
from percept.cache.entry import decode
run = decode(Path(sys.argv[1]).read_bytes())
cache = PosteriorCache(Path(sys.argv[3]))
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
assert cache.run((1,), lambda: run) is run
print(sorted(path.name for path in Path(sys.argv[3]).iterdir()))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="limits of file sizes are POSIX")
def test_no_room_on_the_disk_is_said_and_leaves_nothing(tmp_path, run):
    (tmp_path / "entry").write_bytes(encode(run))
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
    assert "file too large" in ran.stderr


TWO = """
import sys
from pathlib import Path
from percept.cache import PosteriorCache
from percept.cache.entry import decode, encode
data = Path(sys.argv[1]).read_bytes()
run = decode(data)
cache = PosteriorCache(Path(sys.argv[2]), limit=3 * len(data))
keys = [f"{i:064x}" for i in range(6)]
found = 0
for turn in range(60):
    cache.store(keys[(turn * int(sys.argv[3])) % 6], run)
    for key in keys:
        loaded = cache.load(key)
        if loaded is not None:
            assert encode(loaded) == data
            found += 1
print(found)
"""


def test_two_processes_that_store_load_and_evict_at_once_never_see_a_torn_entry(tmp_path, run):
    (tmp_path / "entry").write_bytes(encode(run))
    arguments = [sys.executable, "-c", TWO, str(tmp_path / "entry"), str(tmp_path / "c")]
    running = [
        subprocess.Popen([*arguments, step], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
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
        decode(path.read_bytes())


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


def test_a_limit_that_is_no_number_is_wrong_usage(monkeypatch):
    monkeypatch.setenv("PERCEPT_CACHE_LIMIT", "2.5")
    assert cache_limit() == 2_500_000
    for wrong in ("lots", "-1", "0", "nan"):
        monkeypatch.setenv("PERCEPT_CACHE_LIMIT", wrong)
        with pytest.raises(UsageError, match=f"PERCEPT_CACHE_LIMIT.*{wrong}.*megabytes"):
            cache_limit()


def test_hits_are_told_to_the_log_only(cache, run, caplog, capsys):
    cache.run((1,), lambda: run)
    with caplog.at_level(logging.INFO, "percept.cache"):
        cache.run((1,), lambda: run)
    assert "found in" in caplog.text
    assert capsys.readouterr() == ("", "")
