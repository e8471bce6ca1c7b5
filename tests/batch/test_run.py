"""Batches on real workers: this process, threads, and a scheduler and workers started by
command."""

import json
import re
import sys
from pathlib import Path

import pandas as pd
import pytest

from percept.batch import analyse, run_batch, sources
from percept.cli import main
from percept.errors import UsageError
from percept.files import exclusive
from percept.workers import in_process, on_cluster, processes
from tests.unmixed import unmixed_sessions
from tests.workers.clusters import QUIET, in_threads, scheduler

CLASSICAL = {"method": "classical"}
SAMPLED = {"tolerance": 0.3, "seed": 3}
pytestmark = QUIET


def batch(studies, out, mapper, changes=CLASSICAL, **options):
    return run_batch(sources(studies, changes=changes), out, mapper, **options)


def test_one_set_of_rows_per_study_and_bad_ones_reported(studies, tmp_path):
    pytest.importorskip("distributed", reason="needs the extra percept-haptics[cluster]")
    told = []
    with in_threads() as client:
        mapper = on_cluster(client)
        summary = batch(
            studies,
            tmp_path / "out",
            mapper,
            progress=lambda summary: told.append((summary.counts.total(), len(summary.failures))),
        )
    assert summary.counts == {"done": 4, "refused": 2, "failed": 1}
    assert (summary.studies, summary.skipped) == (7, 0)
    table = pd.read_csv(summary.table)
    assert list(dict.fromkeys(table["study"])) == studies
    message = table.set_index("study")["message"]
    assert message[studies[2]].startswith(f"{studies[2]}:2, column 'k_adj', value 'much'")
    assert table.set_index("study")["lower"].isna()[studies[2]]
    assert "no row has an adjustment" in message[studies[4]]
    assert "there is no such file" in message[studies[6]]
    assert [finished for finished, _ in told] == list(range(1, 8))
    assert told[-1] == (7, 3)
    alone = analyse(sources(studies[:1], changes=CLASSICAL)[0].read())
    assert alone.rows in summary.table.read_text()


def test_processes_of_this_machine_and_threads_of_dask_give_the_same_bytes(studies, tmp_path):
    pytest.importorskip("distributed", reason="needs the extra percept-haptics[cluster]")
    few = studies[1:3]
    first = batch(few, tmp_path / "here", in_process, SAMPLED).table
    assert set(pd.read_csv(first)["method"].dropna()) == {"classical", "bayesian"}
    with in_threads() as client:
        there = batch(few, tmp_path / "threads", on_cluster(client), SAMPLED).table
    beside = batch(few, tmp_path / "processes", processes(2), SAMPLED).table
    assert first.read_bytes() == there.read_bytes() == beside.read_bytes()


@pytest.mark.evidence
def test_workers_far_away_give_the_same_bytes(studies, tmp_path, capsys):
    pytest.importorskip("distributed", reason="needs the extra percept-haptics[cluster]")
    few = studies[1:3]
    first = batch(few, tmp_path / "here", in_process, SAMPLED).table
    words = ["batch", *few, "--tolerance", "0.3", "--seed", "3", "--out", str(tmp_path / "remote")]
    with scheduler(tmp_path, workers=1) as (_, address):
        assert main([*words, "--scheduler", address]) == 1
    assert "text.csv:2" in capsys.readouterr().err
    assert (tmp_path / "remote" / first.name).read_bytes() == first.read_bytes()


def test_a_second_run_analyses_only_what_is_new_or_failed(studies, tmp_path):
    batch(studies[:3], tmp_path / "out", in_process)
    Path(studies[6]).write_text(Path(studies[0]).read_text())
    again = batch(studies, tmp_path / "out", in_process)
    fresh = batch(studies, tmp_path / "fresh", in_process)
    assert again.skipped == 3
    assert again.counts == fresh.counts == {"done": 5, "refused": 2}
    assert set(again.failures) == set(fresh.failures)
    assert again.table.read_bytes() == fresh.table.read_bytes()


def broken(function, arguments):
    """Workers whose second answer is that they died."""
    for number, (argument, result) in enumerate(in_process(function, arguments)):
        yield argument, OSError("killed") if number == 1 else result


def test_a_study_without_an_answer_failed_and_a_later_run_tries_it_again(studies, tmp_path):
    summary = batch(studies[:2], tmp_path / "out", broken)
    assert summary.counts == {"done": 1, "failed": 1}
    assert summary.failures == [(studies[1], "OSError: killed")]
    assert list(pd.read_csv(summary.table)["message"])[-1] == "OSError: killed"
    again = batch(studies[:2], tmp_path / "out", in_process)
    assert (again.skipped, again.counts, again.failures) == (1, {"done": 2}, [])


@pytest.mark.skipif(sys.platform == "win32", reason="folders are not locked there")
def test_a_second_batch_is_told_to_wait(studies, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    with exclusive(out), pytest.raises(UsageError, match="another run is writing into it"):
        batch(studies[:1], out, in_process)
    assert batch(studies[:1], out, in_process).counts == {"done": 1}


def test_the_command(studies, tmp_path, capsys):
    words = ["--method", "classical", "--workers", "1", "--out", str(tmp_path / "out")]
    assert main(["batch", *studies, *words]) == 1
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[0] == "7 studies (4 done, 1 failed, 2 refused): 0 finished before, 7 now"
    assert lines[-1] == str(tmp_path / "out" / "batch.csv")
    assert "text.csv:2" in printed.err
    assert main(["batch", studies[0], *words, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["studies"], summary["skipped"], summary["counts"]) == (1, 1, {"done": 1})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--workers", "0"], "--workers.*at least 1"),
        (["--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], "Give --workers or --scheduler"),
        (["--level", "2"], "inference.level"),
    ],
)
def test_wrong_usage_starts_nothing(studies, tmp_path, capsys, arguments, message):
    assert main(["batch", studies[0], *arguments, "--out", str(tmp_path / "out")]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_a_withheld_posterior_is_no_success(tmp_path, capsys):
    path = tmp_path / "s.csv"
    unmixed_sessions("VE2").to_csv(path, index=False)
    (tmp_path / "hasty.toml").write_text("[inference]\ntolerance = 0.01\nmost_steps = 200\n")
    words = [
        "batch",
        str(path),
        "--scene",
        str(tmp_path / "hasty.toml"),
        "--out",
        str(tmp_path / "out"),
        "--quiet",
    ]
    assert main([*words, "--workers", "1"]) == 1
    captured = capsys.readouterr()
    assert "autocorrelation times" in captured.err
    assert "1 study (1 withheld)" in captured.out
    found = pd.read_csv(tmp_path / "out" / "batch.csv")
    assert set(found["status"]) == {"withheld"}
    assert set(found["method"]) == {"classical"}
    assert "autocorrelation times" in found["message"][0]
