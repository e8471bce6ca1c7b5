import hashlib
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from percept.errors import UsageError
from percept.files import exclusive, filled_folder, whole_file, write_whole

posix = pytest.mark.skipif(sys.platform == "win32", reason="folders are not locked there")


def test_a_file_is_replaced_whole_and_nothing_stays_beside_it(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, b"old")
    write_whole(path, b"new")
    assert path.read_bytes() == b"new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


@posix
def test_others_may_read_a_file_as_any_new_one(tmp_path):
    write_whole(tmp_path / "a.txt", b"x")
    (tmp_path / "plain.txt").write_bytes(b"x")
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain.txt").stat().st_mode


@posix
def test_a_link_stays_one(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "b.txt").write_text("old")
    (tmp_path / "a.txt").symlink_to(Path("there") / "b.txt")
    write_whole(tmp_path / "a.txt", b"new")
    assert (tmp_path / "a.txt").is_symlink()
    assert (tmp_path / "there" / "b.txt").read_bytes() == b"new"


def test_an_error_while_writing_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, b"old")

    def stopped():
        with whole_file(path) as aside:
            aside.write_bytes(b"ne")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_only_old_leftovers_of_ours_are_removed(tmp_path):
    for name in (".percept-unfinished-old", ".percept-unfinished-new", ".mine"):
        (tmp_path / name).write_text("")
    for name in (".percept-unfinished-old", ".mine"):
        os.utime(tmp_path / name, (1e9, 1e9))
    write_whole(tmp_path / "a.txt", b"x")
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        ".mine",
        ".percept-unfinished-new",
        "a.txt",
    ]


@posix
def test_one_holds_a_folder_alone(tmp_path):
    with (
        exclusive(tmp_path),
        pytest.raises(UsageError, match="another run is writing into it"),
        exclusive(tmp_path, wait=False),
    ):
        raise AssertionError("held alone twice")


@posix
def test_a_lock_ends_with_its_process(tmp_path):
    code = (
        "import os, sys, signal\nfrom pathlib import Path\nfrom percept.files import exclusive\n"
        "with exclusive(Path(sys.argv[1])):\n    os.kill(os.getpid(), signal.SIGKILL)"
    )
    ran = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert ran.returncode < 0
    with exclusive(tmp_path, wait=False):
        pass


@posix
def test_who_waits_gets_it_when_it_is_free(tmp_path):
    order = []

    def wait():
        with exclusive(tmp_path):
            order.append("second")

    with exclusive(tmp_path):
        waiting = threading.Thread(target=wait)
        waiting.start()
        waiting.join(0.2)
        order.append("first")
    waiting.join(10)
    assert order == ["first", "second"]


@posix
def test_a_file_system_without_locks_is_told_and_not_an_error(tmp_path, monkeypatch):
    import errno
    import fcntl

    def refuse(handle, how):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with exclusive(tmp_path, wait=False), exclusive(tmp_path, wait=False):
        pass


def test_what_an_earlier_run_wrote_goes_unless_somebody_changed_it(tmp_path):
    def fill(*names):
        with filled_folder(tmp_path / "out", last="page.html") as folder:
            for name in names:
                (folder / name).write_text(f"{name} of the program")

    fill("page.html", "posterior.nc", "old.csv", "edited.csv")
    (tmp_path / "out" / "edited.csv").write_text("mine now")
    (tmp_path / "out" / "notes.txt").write_text("mine")
    fill("page.html", "new.csv")
    found = {path.name: path.read_text() for path in (tmp_path / "out").iterdir()}
    assert found.pop("page.sha256").count("\n") == 2
    assert found == {
        "page.html": "page.html of the program",
        "new.csv": "new.csv of the program",
        "edited.csv": "mine now",
        "notes.txt": "mine",
    }


def test_a_list_that_points_outside_its_folder_is_not_followed(tmp_path):
    outside = tmp_path / "outside.txt"
    outside.write_text("mine")
    digest = hashlib.sha256(b"mine").hexdigest()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "page.sha256").write_text(
        f"{digest}  ../outside.txt\n{digest}  {outside}\nnonsense\n"
    )
    with filled_folder(tmp_path / "out", last="page.html") as folder:
        (folder / "page.html").write_text("x")
    assert outside.read_text() == "mine"
