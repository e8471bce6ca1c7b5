import contextlib
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from percept.errors import UsageError
from percept.files import (
    MARKER,
    exclusive,
    filled_folder,
    inert,
    own_folder,
    write_whole,
)  # fmt: skip

posix = pytest.mark.skipif(sys.platform == "win32", reason="folders are not locked there")


def test_a_file_is_replaced_whole_and_nothing_stays_beside_it(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, b"old")
    write_whole(path, b"new")
    assert path.read_bytes() == b"new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("start", ["", " ", "\t", "\u00a0 ", "\n"])
@pytest.mark.parametrize("sign", ["=", "+", "-", "@", "＝"])
def test_text_that_a_spreadsheet_would_run_is_marked(start, sign):
    assert inert(f"{start}{sign}1") == f"'{start}{sign}1"
    assert inert(f"{start}a{sign}1") == ("'" if start == "\t" else "") + f"{start}a{sign}1"


@posix
def test_a_link_stays_one(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "b.txt").write_text("old")
    (tmp_path / "a.txt").symlink_to(Path("there") / "b.txt")
    write_whole(tmp_path / "a.txt", b"new")
    assert (tmp_path / "a.txt").is_symlink()
    assert (tmp_path / "there" / "b.txt").read_bytes() == b"new"


def test_an_error_while_writing_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    write_whole(path, b"old")

    def stopped(handle):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", stopped)
    with pytest.raises(KeyboardInterrupt):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


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


PAGE = ("page.html", "posterior.nc", "tables/data_*.csv")


def fill(out, *names, text="of the program", **options):
    """Write files as one run of a command does."""
    with filled_folder(out, PAGE, **options) as folder:
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(f"{name} {text}")


def found(out):
    return {
        path.relative_to(out).as_posix(): path.read_text()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != MARKER
    }


def test_what_an_earlier_run_wrote_goes_and_what_is_not_its_own_stays(tmp_path):
    fill(tmp_path, "page.html", "posterior.nc", "tables/data_k.csv")
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "tables" / "mine.csv").write_text("mine")
    fill(tmp_path, "page.html", "tables/data_b.csv")
    written = (tmp_path / MARKER).read_text().splitlines()
    assert written == [
        "# percept wrote these files. It replaces and removes them.",
        "page.html",
        "tables/data_b.csv",
    ]
    assert found(tmp_path) == {
        "notes.txt": "mine",
        "page.html": "page.html of the program",
        "tables/data_b.csv": "tables/data_b.csv of the program",
        "tables/mine.csv": "mine",
    }


@pytest.mark.parametrize("name", ["page.html", "notes.txt", "tables/data_x.csv"])
def test_a_folder_of_other_files_is_refused_before_anything_is_made(tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    (tmp_path / ".hidden").write_text("mine")
    before = found(tmp_path)
    with pytest.raises(UsageError, match="holds what percept did not write, such as") as refused:
        fill(tmp_path, "page.html")
    assert refused.value.file == str(tmp_path)
    assert "--force" in refused.value.hint
    assert found(tmp_path) == before
    fill(tmp_path, "page.html", force=True)
    assert found(tmp_path) == {**before, "page.html": "page.html of the program"}
    # Now the folder is percept's.
    fill(tmp_path, "page.html", text="again")
    assert found(tmp_path) == {**before, "page.html": "page.html again"}


def test_a_file_that_somebody_else_puts_there_meanwhile_is_refused_at_the_end(tmp_path):
    def meanwhile():
        with filled_folder(tmp_path, PAGE) as folder:
            (folder / "page.html").write_text("x")
            (tmp_path / "page.html").write_text("mine")

    with pytest.raises(UsageError, match=r"such as page\.html"):
        meanwhile()
    assert found(tmp_path) == {"page.html": "mine"}


@posix
def test_nothing_is_written_or_removed_through_a_link(tmp_path):
    out = tmp_path / "out"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "data_k.csv").write_text("mine")
    out.mkdir()
    (out / "tables").symlink_to(elsewhere)
    for force in (False, True):
        with pytest.raises(UsageError, match="a folder is needed here, and this is a link"):
            fill(out, "page.html", "tables/data_k.csv", force=force)
    (out / "tables").unlink()
    (out / "page.html").symlink_to(elsewhere / "data_k.csv")
    (out / "posterior.nc").symlink_to(elsewhere / "nowhere")
    (out / MARKER).write_text("posterior.nc\n")
    fill(out, "page.html")
    assert found(elsewhere) == {"data_k.csv": "mine"}
    assert not (out / "page.html").is_symlink()
    assert (out / "posterior.nc").is_symlink()


def test_a_list_removes_nothing_but_what_the_command_writes(tmp_path):
    out = tmp_path / "out"
    (out / "tables").mkdir(parents=True)
    names = ["../outside.txt", "notes.txt", "tables/mine.csv", "tables/../../outside.txt"]
    for name in names:
        (out / name).write_text("mine")
    (out / MARKER).write_text("".join(f"{name}\n" for name in names))
    fill(out, "page.html")
    assert [(out / name).read_text() for name in names] == ["mine"] * len(names)


def test_a_folder_in_a_file_s_place_is_refused(tmp_path):
    fill(tmp_path, "page.html")
    (tmp_path / "posterior.nc").mkdir()
    with pytest.raises(UsageError, match=r"posterior\.nc: a file is needed here"):
        fill(tmp_path, "page.html", "posterior.nc", text="again")
    assert found(tmp_path) == {"page.html": "page.html of the program"}


def test_a_folder_of_one_s_own_is_marked(tmp_path):
    out = own_folder(tmp_path / "new" / "out")
    assert [path.name for path in out.iterdir()] == [MARKER]
    (out / "a.txt").write_text("x")
    assert own_folder(out) == out


def test_commands_of_one_folder_know_each_other_s_files(tmp_path):
    fit = ("fit.json", "posterior.nc")
    fill(tmp_path, "page.html", "posterior.nc")
    with filled_folder(tmp_path, fit) as folder:
        (folder / "fit.json").write_text("fit")
        (folder / "posterior.nc").write_text("of the fit")
    fill(tmp_path, "page.html", "posterior.nc")
    assert found(tmp_path)["posterior.nc"] == "posterior.nc of the program"
    assert found(tmp_path)["fit.json"] == "fit"


@pytest.mark.parametrize("moves", range(6))
def test_a_run_that_dies_while_it_moves_files_leaves_no_foreign_file(tmp_path, monkeypatch, moves):
    """Whichever move is its last, the next run finds its own files."""
    fill(tmp_path, "page.html", "posterior.nc", "tables/data_k.csv", text="first")
    replace, done = Path.replace, []

    def dying(path, target):
        if len(done) == moves:
            raise KeyboardInterrupt
        done.append(target)
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", dying)
    with contextlib.suppress(KeyboardInterrupt):
        fill(tmp_path, "page.html", "posterior.nc", "tables/data_b.csv", text="second")
    monkeypatch.undo()
    fill(tmp_path, "page.html", text="third")
    assert found(tmp_path) == {"page.html": "page.html third"}
