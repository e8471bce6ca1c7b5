from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from percept.calibration.checkpoint import Checkpoint
from percept.errors import UsageError


def kept(path: Path | None, plan: str = "a") -> Checkpoint[float]:
    def unpack(line: Mapping[str, Any]) -> float:
        return float(line["value"])

    return Checkpoint(path, plan, what="tried", pack=lambda value: {"value": value}, unpack=unpack)


def test_each_plan_reads_what_it_wrote(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "tried.jsonl"
    assert kept(path).read(9) == {}
    for index, value in ((0, 1.5), (4, 0.1), (2, 7.0)):
        kept(path).append(index, value)
    kept(path, "b").append(0, -1.0)
    assert kept(path).read(9) == {0: 1.5, 4: 0.1, 2: 7.0}
    assert kept(path).read(3) == {0: 1.5, 2: 7.0}
    assert kept(path, "b").read(9) == {0: -1.0}


@pytest.mark.parametrize("length", [1, 9, 25, 36])
def test_a_line_cut_short_anywhere_is_dropped_and_writing_goes_on(tmp_path: Path, length: int) -> None:
    path = tmp_path / "tried.jsonl"
    kept(path).append(0, 1.5)
    whole = path.read_text()
    path.write_text(whole[:length])
    assert kept(path).read(9) == {}
    kept(path).append(1, 2.5)
    assert kept(path).read(9) == {1: 2.5}
    path.write_text(whole + whole[:length])
    assert kept(path).read(9) == {0: 1.5}
    assert path.read_text() == whole


@pytest.mark.parametrize(
    ("text", "row"),
    [("notes", 1), ("notes\n", 1), ('{"plan": "a", "index": 0}\n', 1), ('{"plan": "b"}\n[]\n', 2)],
)
def test_a_file_of_something_else_is_refused_and_left_alone(tmp_path: Path, text: str, row: int) -> None:
    path = tmp_path / "tried.jsonl"
    path.write_text(text)
    with pytest.raises(UsageError, match=rf"tried\.jsonl:{row}: not a line of tried studies"):
        kept(path).read(9)
    assert path.read_text() == text


def test_no_file_keeps_nothing() -> None:
    kept(None).append(0, 1.0)
    assert kept(None).read(9) == {}


def test_what_is_no_file_of_results_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.jsonl").mkdir()
    (tmp_path / "bytes.jsonl").write_bytes(b"\xff\xfe\x00")
    for name in ("folder.jsonl", "bytes.jsonl"):
        with pytest.raises(UsageError, match=rf"{name}: no file of tried studies\. Choose another folder"):
            kept(tmp_path / name).read(3)
