"""Full disks, folders that may not be written, and two runs at once, on real file systems."""

import contextlib
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from percept.cli import main
from percept.files import exclusive, filled_folder
from tests import DATASETS

resource = pytest.importorskip("resource", reason="limits, locks and mounts are POSIX")
pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="limits, locks and mounts are POSIX"
)
STUDY = str(DATASETS / "hbfd_sessions.csv")
_SIZE = 1 << 20
ONE = ("a.txt",)
# A command under a limit on the size of files.
LIMITED = """
import sys
from percept.cli import main
from tests.survival.test_folders import files_no_larger_than
with files_no_larger_than(500_000):
    sys.exit(main(sys.argv[1:]))
"""


@contextlib.contextmanager
def files_no_larger_than(size):
    """A limit on the size of files, which fails as a full disk does: in the middle of a write."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    # Python would cut compiled modules short too, and read them later.
    sys.dont_write_bytecode, writes = True, sys.dont_write_bytecode
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = writes


@contextlib.contextmanager
def small_disk(folder, size):
    """Mount a file system in memory of so many bytes; skip where that is not allowed."""
    folder.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)],
        capture_output=True,
        check=False,
    )
    if made.returncode != 0:
        pytest.skip("no file system can be mounted here: a limit on file sizes stands for it")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_posterior_that_does_not_fit_is_an_error_and_ends_no_process(tmp_path):
    """HDF5 itself ends the process when it closes a file on a full disk."""
    root = Path(__file__).parents[2]
    words = ["fit", "tests/golden/data/one_environment.csv", "--out", str(tmp_path / "out")]
    ran = subprocess.run(
        [sys.executable, "-c", LIMITED, *words, "--method", "bayesian", "--tolerance", "0.3"],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 2
    assert "cannot be written: File too large" in ran.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["fit", pytest.param("report", marks=pytest.mark.evidence)])
def test_a_write_that_stops_half_way_is_said_and_leaves_nothing(tmp_path, capsys, command):
    with files_no_larger_than(4000):
        code = main([command, STUDY, "--method", "classical", "--out", str(tmp_path / "out")])
    assert code == 2
    assert "cannot be written: File too large" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_batch_that_finds_no_room_keeps_what_it_had_and_goes_on_later(tmp_path, capsys):
    arguments = ["batch", STUDY, "--method", "classical", "--workers", "1"]
    arguments += ["--out", str(tmp_path / "out")]
    with files_no_larger_than(4000):
        assert main(arguments) == 2
    said = capsys.readouterr().err
    assert "written: File too large" in said
    assert "run the same command again" in said
    left = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert left <= {".percept", "finished.jsonl"}
    assert main([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["counts"] == {"done": 1}


@pytest.mark.parametrize("command", ["fit", "batch"])
def test_a_folder_that_may_not_be_written_is_said(tmp_path, capsys, command):
    with small_disk(tmp_path / "disk", _SIZE) as disk:
        (disk / "out").mkdir()
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        code = main([command, STUDY, "--method", "classical", "--out", str(disk / "out")])
    assert code == 2
    said = capsys.readouterr().err
    assert "written: Read-only file system" in said
    assert str(disk) in said


def test_a_run_that_is_told_to_end_leaves_nothing(tmp_path):
    """SIGTERM comes from job schedulers, and from a machine that shuts down."""
    words = ["fit", STUDY, "--tolerance", "0.001", "--no-cache", "--quiet"]
    running = subprocess.Popen(
        [sys.executable, "-m", "percept", *words, "--out", str(tmp_path / "out")]
    )
    while not list(tmp_path.iterdir()):
        assert running.poll() is None
        time.sleep(0.05)
    running.terminate()
    assert running.wait(60) == 143
    assert list(tmp_path.iterdir()) == []


def test_moves_of_two_runs_do_not_mix(tmp_path):
    """While one run holds the folder the other waits with its files aside."""
    out = tmp_path / "out"
    out.mkdir()
    code = (
        "import sys\nfrom percept.files import filled_folder\n"
        "files = ('z.txt', 'a.txt')\n"
        "with filled_folder(sys.argv[1], files) as f:\n"
        "    for n in ('a.txt', 'z.txt'):\n        (f / n).write_text('other\\n')\n"
        "    print('filled', flush=True)\n"
    )
    with exclusive(out):
        process = subprocess.Popen(
            [sys.executable, "-c", code, str(out)], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout.readline() == "filled\n"
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.5)
        assert all(path.name.startswith(".percept-unfinished-") for path in out.iterdir())
    process.communicate()
    assert process.returncode == 0
    assert sorted(path.name for path in out.iterdir()) == [".percept", "a.txt", "z.txt"]


def test_a_folder_on_another_disk_or_of_a_long_name_is_filled(tmp_path):
    """Nothing can be moved in one go from beside a link or a mount point to what is behind it."""
    disk = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else tmp_path))
    try:
        (tmp_path / "link").symlink_to(disk)
        for out in (tmp_path / "link", tmp_path / "link" / "new", tmp_path / ("long" * 60)):
            with filled_folder(out, ONE) as aside:
                (aside / "a.txt").write_text("x")
            assert (out / "a.txt").read_text() == "x"
        assert (tmp_path / "link").is_symlink()
        assert sorted(path.name for path in disk.iterdir()) == [".percept", "a.txt", "new"]
    finally:
        shutil.rmtree(disk)
