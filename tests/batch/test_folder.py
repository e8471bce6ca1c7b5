import sys

import pandas as pd
import pytest

from percept.batch_folder import BatchFolder, Kept, encode
from percept.errors import UsageError

KEYS = [f"{i:02x}" + "0" * 62 for i in range(3)]


def saved(folder, key, status="refused"):
    folder.save(key, encode(f"study {key[:2]}", key, status, "because"))


def file_of(folder, key):
    return folder.out / "studies" / key[:2] / f"{key}.csv"


def test_the_table_has_the_studies_in_the_order_asked_for(tmp_path):
    pq = pytest.importorskip("pyarrow.parquet", reason="needs the extra percept-haptics[tables]")
    with BatchFolder.opened(tmp_path / "out") as folder:
        for key in KEYS:
            saved(folder, key)
        asked = 50 * KEYS[::-1]
        tables = [folder.combine(asked, form) for form in ("csv", "parquet")]
    assert list(pd.read_csv(tables[0], dtype=str)["key"]) == asked
    assert pq.read_table(tables[1])["key"].to_pylist() == asked
    assert pq.ParquetFile(tables[1]).num_row_groups == 2


def test_a_failed_study_says_so_until_it_is_done(tmp_path):
    with BatchFolder.opened(tmp_path) as folder:
        assert folder.kept(KEYS[0]) is None
        saved(folder, KEYS[0], "failed")
        assert folder.kept(KEYS[0]).status == "failed"
        saved(folder, KEYS[0])
        assert folder.kept(KEYS[0]) == Kept("refused", "because")
    assert [path.name for path in tmp_path.rglob("*.csv")] == [f"{KEYS[0]}.csv"]


@pytest.mark.parametrize(
    "harm",
    [
        lambda data: b"",
        lambda data: b"\xff" + data,
        lambda data: data.replace(KEYS[0].encode(), KEYS[1].encode()),
        lambda data: data.replace(b"refused", b"perhaps"),
        lambda data: data[data.find(b"\n") + 1 :],
    ],
    ids=["empty", "no text", "another study's", "no status", "no header"],
)
def test_a_file_that_no_batch_wrote_holds_no_rows(tmp_path, harm):
    with BatchFolder.opened(tmp_path) as folder:
        saved(folder, KEYS[0])
        path = file_of(folder, KEYS[0])
        path.write_bytes(harm(path.read_bytes()))
        assert folder.kept(KEYS[0]) is None


def test_a_folder_that_percept_did_not_mark_is_not_written_into(tmp_path):
    table = tmp_path / "batch.csv"
    table.write_text("mine")
    message = r"the folder holds what percept did not write, such as batch\.csv.*--force"
    with pytest.raises(UsageError, match=message):
        BatchFolder.opened(tmp_path).__enter__()
    assert [path.name for path in tmp_path.iterdir()] == ["batch.csv"]
    with BatchFolder.opened(tmp_path, force=True) as folder:
        saved(folder, KEYS[0])
        assert folder.combine(KEYS[:1], "csv") == table
    assert "because" in table.read_text()
    with BatchFolder.opened(tmp_path) as folder:
        assert folder.kept(KEYS[0]) == Kept("refused", "because")


def test_a_file_in_the_way_is_said(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(UsageError, match="a folder is needed here"):
        BatchFolder.opened(tmp_path / "out").__enter__()


@pytest.mark.skipif(sys.platform == "win32", reason="folders are not locked there")
def test_a_second_batch_is_told_to_wait(tmp_path):
    with (
        BatchFolder.opened(tmp_path),
        pytest.raises(UsageError, match="another run is writing into it"),
        BatchFolder.opened(tmp_path),
    ):
        raise AssertionError("both hold the folder")
    with BatchFolder.opened(tmp_path) as folder:
        saved(folder, KEYS[0])
