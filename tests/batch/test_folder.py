import sys

import pyarrow.parquet as pq
import pytest

from percept.batch import BatchFolder, encode
from percept.errors import UsageError

KEYS = [f"{i:02x}" + "0" * 62 for i in range(300)]


def saved(folder, key, status="refused"):
    folder.save(key, encode(f"study {key[:2]}", key, status, "because"))


def test_the_table_has_the_studies_in_the_order_asked_for(tmp_path):
    with BatchFolder.opened(tmp_path / "out") as folder:
        for key in KEYS:
            saved(folder, key)
        table = folder.combine(KEYS[::-1])
    assert pq.read_table(table)["key"].to_pylist() == KEYS[::-1]
    assert pq.ParquetFile(table).num_row_groups == 3


def test_a_failed_study_is_not_finished_until_it_is(tmp_path):
    with BatchFolder.opened(tmp_path) as folder:
        saved(folder, KEYS[0], "failed")
        assert folder.verdict(KEYS[0]) is None
        saved(folder, KEYS[0])
        assert folder.verdict(KEYS[0]) == ("refused", "because")
    assert sorted(p.name for p in tmp_path.rglob("*.parquet")) == [f"{KEYS[0]}.parquet"]


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


def test_a_file_in_the_way_is_said(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(UsageError, match="a folder is needed here"):
        BatchFolder.opened(tmp_path / "out").__enter__()
