"""Batches on real workers: threads here, processes here, and a scheduler and workers started by command."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

distributed = pytest.importorskip("distributed", reason="needs the extra percept[cluster]")

from percept.batch import connected, run_batch, sources  # noqa: E402 - only where distributed is installed
from percept.batch.work import analyse  # noqa: E402
from percept.cli import main  # noqa: E402
from percept.errors import RefusalError, UsageError  # noqa: E402
from tests.batch.conftest import study_text  # noqa: E402

CLASSICAL = {"method": "classical"}
SAMPLED = {"tolerance": 0.3, "seed": 3}
DASK = [sys.executable, "-m", "dask"]
LOOPBACK = ["--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0"]
UNBUFFERED = {**os.environ, "PYTHONUNBUFFERED": "1"}
# What dask leaves open or says of itself while it starts and ends.
pytestmark = [
    pytest.mark.filterwarnings("default::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@contextlib.contextmanager
def in_process():
    """A cluster of dask in this process: two workers of one thread."""
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


def start(log, *arguments):
    """Start a command of dask that writes what it says to a file."""
    with log.open("w") as file:
        return subprocess.Popen([*DASK, *arguments], stderr=file, env=UNBUFFERED)


def address_in(log):
    """Where a scheduler just started listens, as it says itself."""
    for _ in range(600):
        if found := re.search(r"Scheduler at:\s+(tcp://127\.0\.0\.1:\d+)", log.read_text()):
            return found[1]
        time.sleep(0.1)
    raise AssertionError(f"no address in: {log.read_text()}")


@pytest.fixture(scope="module")
def remote(tmp_path_factory):
    """The address of a scheduler on loopback, with two workers, each a process of its own."""
    logs = tmp_path_factory.mktemp("dask")
    running = [start(logs / "scheduler", "scheduler", "--port", "0", *LOOPBACK)]
    address = address_in(logs / "scheduler")
    running += [start(logs / name, "worker", address, "--nthreads", "1", *LOOPBACK) for name in ("a", "b")]
    with distributed.Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    yield address
    for process in reversed(running):
        process.send_signal(signal.SIGINT)
    for process in running:
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def batch(studies, out, client, changes=CLASSICAL, **options):
    return run_batch(sources(studies, changes=changes), out, client, **options)


def test_one_set_of_rows_per_study_and_bad_ones_reported(studies, tmp_path):
    told = []
    with in_process() as client:
        summary = batch(studies, tmp_path / "out", client, progress=lambda *state: told.append(state))
    assert summary.counts == {"done": 4, "refused": 2, "failed": 1}
    assert (summary.studies, summary.skipped) == (7, 0)
    table = pq.read_table(summary.table).to_pandas()
    assert list(dict.fromkeys(table["study"])) == studies
    message = table.set_index("study")["message"]
    assert "text.csv:2, column 'k_adj', value 'much'" in message[studies[2]]
    assert "no row holds an adjustment" in message[studies[4]]
    assert "there is no such file" in message[studies[6]]
    assert [state[:2] for state in told] == [(i, 7) for i in range(1, 8)]
    assert told[-1] == (7, 7, 3)
    alone = analyse(sources(studies[:1], changes=CLASSICAL)[0].read())
    (row,) = set(table.loc[table["study"] == studies[0], "key"])
    assert (tmp_path / "out/studies" / row[:2] / f"{row}.parquet").read_bytes() == alone.table


def test_workers_in_processes_or_far_away_give_the_same_bytes(studies, tmp_path, remote):
    few = studies[1:3]
    with in_process() as client:
        first = batch(few, tmp_path / "threads", client, SAMPLED).table
    assert set(pq.read_table(first)["method"].to_pylist()) == {"classical", "bayesian", None}
    with connected(workers=1) as client:
        assert batch(few, tmp_path / "one", client, SAMPLED).table.read_bytes() == first.read_bytes()
    with connected(scheduler=remote) as client:
        assert batch(few, tmp_path / "remote", client, SAMPLED).table.read_bytes() == first.read_bytes()


def test_a_second_run_analyses_only_what_is_new_or_failed(studies, tmp_path):
    with in_process() as client:
        batch(studies[:3], tmp_path / "out", client)
        Path(studies[6]).write_text(Path(studies[0]).read_text())
        again = batch(studies, tmp_path / "out", client)
        fresh = batch(studies, tmp_path / "fresh", client)
    assert again.skipped == 3
    assert sum(again.counts.values()) == 4
    assert again.table.read_bytes() == fresh.table.read_bytes()


def test_a_worker_that_dies_costs_no_study(tmp_path):
    many = []
    for i in range(40):
        many.append(str(tmp_path / f"s{i}.csv"))
        Path(many[-1]).write_text(study_text(i))
    with in_process() as client:
        wanted = batch(many, tmp_path / "whole", client).table.read_bytes()
    killed = []

    def kill(done, total, failed):
        if done in (5, 20):
            killed.append(next(iter(client.run(os.getpid).values())))
            os.kill(killed[-1], signal.SIGKILL)

    with connected(workers=2) as client:
        summary = batch(many, tmp_path / "out", client, progress=kill)
    assert len(set(killed)) == 2
    assert summary.counts == {"done": 40}
    assert summary.table.read_bytes() == wanted


def test_a_lost_scheduler_is_said_and_a_later_run_goes_on(studies, tmp_path):
    scheduler = start(tmp_path / "log", "scheduler", "--port", "0", *LOOPBACK)

    def wait_in_vain():
        with connected(scheduler=address_in(tmp_path / "log")) as client:
            threading.Timer(1.0, scheduler.kill).start()  # no worker is there: the batch waits
            batch(studies[:2], tmp_path / "out", client)

    try:
        with pytest.raises(RefusalError, match=r"the scheduler was lost.*What is finished is kept"):
            wait_in_vain()
    finally:
        scheduler.kill()
        scheduler.wait()
    with in_process() as client:
        assert batch(studies[:2], tmp_path / "out", client).counts == {"done": 2}


def test_the_command(studies, tmp_path, capsys, remote):
    listed = tmp_path / "list.txt"
    listed.write_text("\n".join(studies[1:]) + "\n\n")
    arguments = ["batch", studies[0], "--from", str(listed), "--method", "classical"]
    arguments += ["--scheduler", remote, "--out", str(tmp_path / "out")]
    assert main(arguments) == 1
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[0] == "7 studies: 0 finished before, 7 now (4 done, 1 failed, 2 refused)"
    assert lines[-1] == str(tmp_path / "out" / "batch.parquet")
    assert "text.csv:2" in printed.err
    assert main([*arguments[:2], *arguments[4:], "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["studies"], summary["skipped"], summary["counts"]) == (1, 1, {})


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


def test_no_scheduler_at_the_address_is_said(monkeypatch):
    monkeypatch.setattr("percept.batch.cluster._SECONDS", 1.0)
    with pytest.raises(UsageError, match=r"tcp://127.0.0.1:1.*no scheduler answers.*dask worker ADDRESS"):
        connected(scheduler="tcp://127.0.0.1:1").__enter__()
