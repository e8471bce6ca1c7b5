"""Studies by their numbers or keys: kept line by line, whoever stops the run."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import pytest

from percept.checkpoint import Checkpoint
from percept.errors import RefusalError, UsageError
from percept.files import exclusive

posix = pytest.mark.skipif(sys.platform == "win32", reason="folders have no locks there")


def kept(path: Path | None, plan: str = "a") -> Checkpoint:
    return Checkpoint(path, plan, what="tried")


def of(value: float) -> dict[str, float]:
    return {"value": value}


def test_each_plan_reads_what_it_wrote(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "tried.jsonl"
    assert kept(path).read() == {}
    for index, value in ((0, 1.5), (4, 0.1), (2, 7.0)):
        kept(path).append(index, of(value))
    kept(path, "b").append(0, of(-1.0))
    assert kept(path).read() == {0: of(1.5), 4: of(0.1), 2: of(7.0)}
    assert kept(path, "b").read() == {0: of(-1.0)}


@pytest.mark.parametrize("length", [1, 9, 25, 36])
def test_a_line_cut_short_anywhere_is_dropped_and_writing_goes_on(
    tmp_path: Path, length: int
) -> None:
    path = tmp_path / "tried.jsonl"
    kept(path).append(0, of(1.5))
    whole = path.read_text()
    path.write_text(whole[:length])
    assert kept(path).read() == {}
    kept(path).append(1, of(2.5))
    assert kept(path).read() == {1: of(2.5)}
    path.write_text(whole + whole[:length])
    assert kept(path).read() == {0: of(1.5)}
    assert path.read_text() == whole


@posix
def test_two_runs_do_not_cut_each_other_s_lines(tmp_path: Path) -> None:
    path = tmp_path / "tried.jsonl"
    kept(path).append(0, of(1.5))
    with exclusive(path):
        threads = [
            threading.Thread(target=kept(path).append, args=(1, of(2.5))),
            threading.Thread(target=kept(path).read, args=()),
        ]
        for thread in threads:
            thread.start()
        # Half a line of somebody who holds the file.
        with path.open("a") as file:
            file.write('{"plan": "a", "in')
            file.flush()
            threads[0].join(0.2)
            file.write('dex": 2, "value": 3.5}\n')
    for thread in threads:
        thread.join(10)
    assert kept(path).read() == {0: of(1.5), 1: of(2.5), 2: of(3.5)}


@pytest.mark.parametrize(
    ("text", "row"),
    [
        ("notes", 1),
        ("notes\n", 1),
        ('{"plan": "a", "index": 0}\n', 1),
        ('{"plan": "b", "index": 0, "value": 1}\n[]\n', 2),
    ],
)
def test_a_file_of_something_else_is_refused_and_left_alone(
    tmp_path: Path, text: str, row: int
) -> None:
    path = tmp_path / "tried.jsonl"
    path.write_text(text)
    with pytest.raises(UsageError, match=rf"tried\.jsonl:{row}: not a line of tried studies"):
        kept(path).read()
    assert path.read_text() == text


def test_no_file_keeps_nothing() -> None:
    kept(None).append(0, of(1.0))
    assert kept(None).read() == {}


def test_what_is_no_file_of_results_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.jsonl").mkdir()
    (tmp_path / "bytes.jsonl").write_bytes(b"\xff\xfe\x00")
    for name in ("folder.jsonl", "bytes.jsonl"):
        with pytest.raises(
            UsageError, match=rf"{name}: no file of tried studies\. Choose another folder"
        ):
            kept(tmp_path / name).read()


def test_only_what_is_not_kept_is_worked_on(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    path = tmp_path / "tried.jsonl"
    kept(path).append(1, of(6.5))
    kept(path).append(1, of(7.5))
    kept(path).append(7, of(-1.0))
    results = kept(path).complete(of, 3, progress=lambda *counts: told.append(counts))
    assert results == [of(0), of(7.5), of(2)]
    assert told == [(2, 3), (3, 3)]
    assert kept(path).read() == {0: of(0.0), 1: of(7.5), 2: of(2.0), 7: of(-1.0)}


def test_an_error_is_said_when_all_others_are_done(tmp_path: Path) -> None:
    path = tmp_path / "tried.jsonl"
    message = (
        r"1 study ended in an error; study 0: ZeroDivisionError: .*the same run again tries these"
    )
    with pytest.raises(RefusalError, match=message) as caught:
        kept(path).complete(lambda index: of(6 / index), 3)
    assert kept(path).read() == {1: of(6.0), 2: of(3.0)}
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
