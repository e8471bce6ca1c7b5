from __future__ import annotations

import hashlib

import pytest

from percept import Scene, Study, read_sessions
from percept.errors import PerceptError, UsageError
from percept.report import dumps, write_report
from percept.report.write import REPORT_FILES

from .conftest import DATASETS


@pytest.fixture
def quick():
    """A study without device: no curves, nothing to sample."""
    scene = Scene(inference={"method": "classical"})
    return Study(read_sessions(DATASETS / "hbfd_sessions.csv"), scene)


def test_everything_promised_is_there(report, both):
    files = {str(path.relative_to(report)) for path in report.rglob("*") if path.is_file()}
    promised = {"report.html", "report.json", "posterior.nc", "references.bib"}
    promised |= {
        f"tables/{name}.csv" for name in ("intervals_k", "intervals_b", "boundaries", "band")
    }
    promised |= {
        f"figures/{name}.svg" for name in ("overview_k", "boundaries_close", "stability", "design")
    }
    assert promised <= files
    assert (report / "report.json").read_text(encoding="utf-8") == dumps(both)


def test_the_posterior_reads_back(report, both_study):
    import xarray as xr

    with xr.open_datatree(report / "posterior.nc", engine="h5netcdf") as tree:
        assert tree.equals(both_study.posterior)
        assert tree["posterior"].attrs["creation_library"] == "percept"


def test_files_of_the_user_stay_and_a_second_run_gives_the_same(quick, tmp_path):
    out = tmp_path / "out"
    write_report(quick, out, date="2026-01-01")
    (out / "notes.txt").write_text("mine")
    (out / "figures").mkdir(exist_ok=True)
    (out / "figures" / "mine.svg").write_text("mine")
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    page = write_report(quick, out, date="2026-01-01")
    assert page == out / "report.html"
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_the_list_is_one_that_sha256sum_reads(report):
    for line in (report / "report.sha256").read_text(encoding="utf-8").splitlines():
        digest, name = line.split("  ")
        assert hashlib.sha256((report / name).read_bytes()).hexdigest() == digest


def test_formats_are_those_asked_for(quick, tmp_path):
    write_report(quick, tmp_path / "out", formats=("pdf",))
    assert {path.name for path in (tmp_path / "out" / "figures").iterdir()} == {
        f"{name}.{form}" for name in ("band", "overview_b", "overview_k") for form in ("pdf",)
    }


def test_a_refusal_leaves_nothing_behind(tmp_path):
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    one = type(read_sessions(DATASETS / "hbfd_sessions.csv")).from_frame(
        table[table["subject"] == "S01"]
    )
    with pytest.raises(PerceptError, match="at least two subjects"):
        write_report(Study(one, Scene()), tmp_path / "deep" / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_format_leaves_nothing_behind(quick, tmp_path):
    with pytest.raises(UsageError, match="figures come as"):
        write_report(quick, tmp_path / "out", formats=("eps",))
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_folder_s_place_is_left_alone(quick, tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(UsageError, match="folder is needed") as caught:
        write_report(quick, tmp_path / "out")
    assert caught.value.file == str(tmp_path / "out")
    assert (tmp_path / "out").read_text() == "mine"


def test_a_folder_that_cannot_be_made_is_named(quick, tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(UsageError, match="cannot be written") as caught:
        write_report(quick, tmp_path / "file" / "out")
    assert caught.value.file == str(tmp_path / "file" / "out")


def test_a_file_of_a_report_s_name_is_refused_before_anything_is_computed(quick, tmp_path):
    mine = tmp_path / "out" / "references.bib"
    mine.parent.mkdir()
    mine.write_text("@book{mine}")
    told = []
    with pytest.raises(UsageError, match="was not written by an earlier run") as refused:
        write_report(quick, tmp_path / "out", progress=told.append)
    assert refused.value.file == str(mine)
    assert told == []
    write_report(quick, tmp_path / "out", force=True)
    assert "percept" in mine.read_text()
    mine.write_text("@book{mine}")
    kept = []
    write_report(quick, tmp_path / "out", say=kept.append)
    assert mine.with_name("references.bib.bak").read_text() == "@book{mine}"
    assert len(kept) == 1


def test_every_file_of_a_report_is_on_the_list_of_its_names(report):
    assert [
        path.name
        for path in report.rglob("*")
        if path.is_file()
        and path.name != "report.sha256"
        and not REPORT_FILES.has(path.relative_to(report).as_posix())
    ] == []


def test_steps_are_told(quick, tmp_path):
    told = []
    write_report(quick, tmp_path / "out", progress=told.append)
    assert told == [
        "intervals", "contrasts", "boundaries", "coupling", "band law", "admissible couplings",
        "sensitivity to the device", "comparison of methods", "checks of the model", "tables",
        "figures", "page",
    ]  # fmt: skip


def test_what_cannot_be_written_is_refused_before_anything_is_worked_out(quick, tmp_path):
    told = []
    with pytest.raises(UsageError, match=r"value 'gif': figures come as svg, pdf, png"):
        write_report(quick, tmp_path / "out", formats=("svg", "gif"), progress=told.append)
    assert told == []
    assert not (tmp_path / "out").exists()


def test_what_stands_in_the_way_is_refused_before_the_first_move(quick, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "tables").write_text("mine")
    with pytest.raises(
        UsageError, match=r"tables: a folder is needed here, and this is a file\. Rename it"
    ):
        write_report(quick, out)
    assert [path.name for path in out.iterdir()] == ["tables"]
    (out / "tables").unlink()
    (out / "report.json").mkdir()
    with pytest.raises(
        UsageError, match=r"report\.json: a file is needed here, and this is a folder"
    ):
        write_report(quick, out)
    assert [path.name for path in out.iterdir()] == ["report.json"]
