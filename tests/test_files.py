import contextlib
import hashlib
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from percept.errors import UsageError
from percept.files import FolderFiles, exclusive, filled_folder, whole_file, write_whole

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


PAGE = FolderFiles("page.html", ("page.html", "posterior.nc", "tables/data_*.csv"))


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
        if path.is_file() and path.suffix != ".sha256"
    }


def test_what_an_earlier_run_wrote_goes_and_what_is_not_its_own_stays(tmp_path):
    fill(tmp_path, "page.html", "posterior.nc", "tables/data_k.csv")
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "tables" / "mine.csv").write_text("mine")
    fill(tmp_path, "page.html", "tables/data_b.csv")
    assert (tmp_path / "page.sha256").read_text().count("\n") == 2
    assert found(tmp_path) == {
        "notes.txt": "mine",
        "page.html": "page.html of the program",
        "tables/data_b.csv": "tables/data_b.csv of the program",
        "tables/mine.csv": "mine",
    }


@pytest.mark.parametrize("again", [True, False])
def test_an_edited_file_is_kept_beside_and_said(tmp_path, again):
    fill(tmp_path, "page.html", "tables/data_k.csv")
    (tmp_path / "tables" / "data_k.csv").write_text("mine now")
    (tmp_path / "tables" / "data_k.csv.bak").write_text("kept before")
    told = []
    fill(tmp_path, "page.html", *(["tables/data_k.csv"] * again), text="again", say=told.append)
    assert len(told) == 1
    assert "data_k.csv was edited since percept wrote it, and is kept as data_k.csv.bak2" in told[0]
    kept = found(tmp_path)
    assert kept.pop("tables/data_k.csv.bak2") == "mine now"
    assert kept.pop("tables/data_k.csv.bak") == "kept before"
    assert kept.pop("page.html") == "page.html again"
    assert kept == ({"tables/data_k.csv": "tables/data_k.csv again"} if again else {})
    # The copy is nobody's to replace: the next run has nothing to say.
    fill(tmp_path, "page.html", say=told.append)
    assert len(told) == 1


def test_an_edited_file_is_said_as_a_warning_in_python(tmp_path):
    fill(tmp_path, "page.html")
    (tmp_path / "page.html").write_text("mine now")
    with pytest.warns(UserWarning, match=r"kept as page\.html\.bak"):
        fill(tmp_path, "page.html")


@pytest.mark.parametrize("name", ["page.html", "posterior.nc", "tables/data_x.csv", "page.sha256"])
def test_a_file_of_somebody_else_is_refused_by_name_before_anything_is_made(tmp_path, name):
    (tmp_path / "tables").mkdir()
    (tmp_path / name).write_text("mine")
    before = found(tmp_path)
    with pytest.raises(UsageError, match="was not written by an earlier run") as refused:
        fill(tmp_path, "page.html")
    assert refused.value.file == str(tmp_path / name)
    assert "--force" in refused.value.hint
    assert found(tmp_path) == before
    fill(tmp_path, "page.html", "tables/data_x.csv", force=True)
    assert found(tmp_path)["page.html"] == "page.html of the program"
    assert found(tmp_path)["tables/data_x.csv"] == "tables/data_x.csv of the program"
    # Only what is written is replaced.
    assert found(tmp_path).get("posterior.nc") == ("mine" if name == "posterior.nc" else None)


def test_a_file_that_somebody_else_puts_there_meanwhile_is_refused_at_the_end(tmp_path):
    def meanwhile():
        with filled_folder(tmp_path, PAGE) as folder:
            (folder / "page.html").write_text("x")
            (tmp_path / "page.html").write_text("mine")

    with pytest.raises(UsageError, match="was not written by an earlier run"):
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
    with pytest.raises(UsageError, match="is a link, and would be replaced"):
        fill(out, "page.html")
    fill(out, "page.html", force=True)
    assert found(elsewhere) == {"data_k.csv": "mine"}
    assert not (out / "page.html").is_symlink()
    assert (out / "posterior.nc").is_symlink()


def test_a_list_removes_nothing_but_what_the_command_writes(tmp_path):
    out = tmp_path / "out"
    (out / "tables").mkdir(parents=True)
    digest = hashlib.sha256(b"mine").hexdigest()
    names = ["../outside.txt", "notes.txt", "tables/mine.csv", "tables/../../outside.txt"]
    for name in names:
        (out / name).write_text("mine")
    fill(out, "page.html")
    listing = out / "page.sha256"
    own = listing.read_text()
    listing.write_text(own + "".join(f"{digest}  {name}\n" for name in names))
    with pytest.raises(UsageError, match=r"page\.sha256: was not written by an earlier run"):
        fill(out, "page.html")
    fill(out, "page.html", force=True)
    assert listing.read_text() == own
    assert [(out / name).read_text() for name in names] == ["mine"] * len(names)


def test_commands_of_one_folder_know_each_other_s_files(tmp_path):
    fit = FolderFiles("fit.json", ("fit.json", "posterior.nc"))
    fill(tmp_path, "page.html", "posterior.nc")
    with filled_folder(tmp_path, fit) as folder:
        (folder / "fit.json").write_text("fit")
        (folder / "posterior.nc").write_text("of the fit")
    fill(tmp_path, "page.html", "posterior.nc")
    assert found(tmp_path)["posterior.nc"] == "posterior.nc of the program"
    assert found(tmp_path)["fit.json"] == "fit"


@pytest.mark.parametrize("moves", range(6))
def test_a_run_that_dies_while_it_moves_files_leaves_no_foreign_file(tmp_path, monkeypatch, moves):
    """Whichever move is its last, the next run finds its own files and has nothing to say."""
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
    told = []
    fill(tmp_path, "page.html", text="third", say=told.append)
    assert told == []
    assert found(tmp_path) == {"page.html": "page.html third"}


@posix
def test_what_a_living_run_holds_is_not_removed_however_old_it_is(tmp_path):
    code = (
        "import sys\nfrom percept.files import FolderFiles, filled_folder\n"
        "with filled_folder(sys.argv[1], FolderFiles('page.html', ('page.html',))) as folder:\n"
        "    print(folder, flush=True)\n    sys.stdin.read()\n"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    aside = Path(holder.stdout.readline().strip())
    os.utime(aside, (1e9, 1e9))
    write_whole(tmp_path / "a.txt", b"x")
    assert aside.is_dir()
    holder.kill()
    holder.communicate()
    write_whole(tmp_path / "a.txt", b"x")
    assert not aside.exists()
