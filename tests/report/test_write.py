from __future__ import annotations

import datetime
import json
from pathlib import Path

import pytest

from percept import Scene, Study, read_sessions
from percept.cli import main
from percept.errors import PerceptError, UsageError
from percept.files import fits
from percept.report.write import REPORT_FILES
from tests.documents import with_rows

from .conftest import DATASETS


@pytest.fixture
def quick():
    """A study without device: no curves, nothing to sample."""
    scene = Scene(inference={"method": "classical"})
    return Study(read_sessions(DATASETS / "hbfd_sessions.csv"), scene)


def test_everything_promised_is_there(report, both):
    files = {str(path.relative_to(report)) for path in report.rglob("*") if path.is_file()}
    promised = {"report.html", "report.json", "posterior.nc", "references.bib"}
    promised |= {f"tables/{name}.csv" for name in ("intervals", "boundaries", "band")}
    promised |= {f"figures/{name}.svg" for name in ("overview", "ratios", "stability")}
    assert promised <= files
    assert with_rows((report / "report.json").read_text(encoding="utf-8")) == both


def test_the_posterior_reads_back(report, both_study):
    import xarray as xr

    with xr.open_datatree(report / "posterior.nc", engine="h5netcdf") as tree:
        assert tree.equals(both_study.posterior)
        assert tree["posterior"].attrs["creation_library"] == "percept"


def test_files_of_the_user_stay_and_a_second_run_gives_the_same(quick, tmp_path):
    out = tmp_path / "out"
    quick.report(out, date="2026-01-01")
    (out / "notes.txt").write_text("mine")
    (out / "figures").mkdir(exist_ok=True)
    (out / "figures" / "mine.svg").write_text("mine")
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    page = quick.report(out, date="2026-01-01")
    assert page == out / "report.html"
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_formats_are_those_asked_for(quick, tmp_path):
    quick.report(tmp_path / "out", formats=("pdf",))
    assert {path.name for path in (tmp_path / "out" / "figures").iterdir()} == {
        f"{name}.pdf" for name in ("band", "overview")
    }


def test_a_refusal_leaves_nothing_behind(tmp_path):
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    one = type(read_sessions(DATASETS / "hbfd_sessions.csv")).from_frame(
        table[table["subject"] == "S01"]
    )
    with pytest.raises(PerceptError, match="at least two subjects"):
        Study(one, Scene()).report(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_other_files_is_refused_before_anything_is_computed(quick, tmp_path):
    mine = tmp_path / "out" / "references.bib"
    mine.parent.mkdir()
    mine.write_text("@book{mine}")
    told = []
    with pytest.raises(UsageError, match=r"such as references\.bib") as refused:
        quick.report(tmp_path / "out", progress=told.append)
    assert refused.value.file == str(mine.parent)
    assert told == []
    quick.report(tmp_path / "out", force=True)
    assert "percept" in mine.read_text()
    mine.write_text("@book{mine}")
    quick.report(tmp_path / "out")
    assert "percept" in mine.read_text()


def test_every_file_of_a_report_is_on_the_list_of_its_names(report):
    assert [
        path.name
        for path in report.rglob("*")
        if path.is_file()
        and path.name != ".percept"
        and not fits(path.relative_to(report).as_posix(), REPORT_FILES)
    ] == []


def test_steps_are_told(quick, tmp_path):
    told = []
    quick.report(tmp_path / "out", progress=told.append)
    assert told == [
        "working out intervals",
        "working out boundaries",
        "judging what can be rendered",
        "fitting the band law",
        "trying other devices",
        "comparing the methods",
        "contrasting levels",
        "judging what feels real",
        "mapping couplings",
        "checking the model",
        "writing tables",
        "writing the posterior",
        "drawing figures",
        "writing the page",
    ]


def test_a_report_made_again_from_its_json_is_the_same_to_the_byte(report, tmp_path, capsys):
    words = ["report", "--from", str(report / "report.json"), "--out", str(tmp_path / "again")]
    assert main([*words, "--formats", "svg"]) == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[-1] == str(tmp_path / "again" / "report.html")
    files = {path.relative_to(report) for path in report.rglob("*") if path.is_file()}
    again = tmp_path / "again"
    assert {path.relative_to(again) for path in again.rglob("*") if path.is_file()} == files
    today = datetime.date.today().isoformat()
    for name in sorted(files, key=str):
        before = (report / name).read_bytes()
        if name.suffix == ".html":
            before = before.replace(b"2026-01-01", today.encode())
        assert (again / name).read_bytes() == before, name


def test_the_answer_alone(report, classical, classical_study, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["report", "--short", "--from", str(report / "report.json")]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("Through this coupling, only VE1 and VE2 can be rendered with every")
    data = str(DATASETS / "sleep.csv")
    words = [data, "--scene", str(DATASETS / "sleep.toml"), "--method", "classical", "--quiet"]
    assert main(["report", "--short", *words]) == 0
    said = capsys.readouterr().out
    assert said.startswith("The gain of sleep is 1.58 h larger for drug second than")
    assert list(tmp_path.iterdir()) == []
    assert list(classical_study.decide()) == classical["summary"]["sentences"]


def test_the_page_again_with_its_answer_in_a_line(report, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["--from", str(report / "report.json"), "--out", str(out)]
    assert main(["report", "--short", *words]) == 0
    assert capsys.readouterr().out.startswith("Through this coupling, only VE1 and VE2 can be")
    assert (out / "report.html").is_file()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "there are no sessions. Name files or folders, or give --from"),
        (["a.csv", "--from", "report.json"], "--from takes results as they are. Leave out the ses"),
        (["--from", "r.json", "--scene", "s.toml", "--level", "0.9"], "Leave out --scene, --level"),
        (["--from", "none.json"], "none.json: cannot be read: No such file or directory"),
        (["--from", "damaged.json"], "damaged.json, data/words: Field required"),
        (["--from", "text.json"], "text.json: is not JSON"),
    ],
)
def test_what_no_report_is_made_from_is_refused(report, tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    damaged = json.loads((report / "report.json").read_text(encoding="utf-8"))
    del damaged["data"]["words"]
    Path("damaged.json").write_text(json.dumps(damaged))
    Path("text.json").write_text("no JSON")
    assert main(["report", *words]) == 2
    assert said in capsys.readouterr().err
    assert not Path("report").exists()


def test_an_unknown_format_leaves_nothing_behind(quick, tmp_path):
    with pytest.raises(UsageError, match="figures come as"):
        quick.report(tmp_path / "out", formats=("eps",))
    assert list(tmp_path.iterdir()) == []
