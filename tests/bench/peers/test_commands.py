"""Whole commands in processes of their own, and the two parts of percept bench that write files."""

import hashlib
import json
from pathlib import Path

import pytest

from percept.bench.peers.reference import stored_reference
from percept.bench.peers.run import run_reference
from percept.bench.peers.whole import whole_commands
from percept.cli import main
from percept.errors import RefusalError


def test_commands_take_turns_and_are_timed(tmp_path):
    log = tmp_path / "log"
    note = "import os, sys; open(sys.argv[1], 'a').write(sys.argv[2] + os.environ['PERCEPT_CACHE'] + ' ')"
    work = note + "; sum(range(6_000_000))"
    commands = {"note": ("-c", note, "SESSIONS", "a"), "work": ("-c", work, "SESSIONS", "b")}
    light, heavy = whole_commands(str(log), "scene.toml", repeats=2, commands=commands)
    assert log.read_text() == "aoff boff " * 3
    assert light.command.startswith('python -c "import os, sys')
    assert len(light.seconds) == 2
    # Both start an interpreter; only one of them works.
    assert heavy.processor > light.processor
    assert heavy.median == pytest.approx(sum(heavy.seconds) / 2)


def test_a_command_that_fails_is_named():
    with pytest.raises(RefusalError, match="-c import no_such_library failed: ModuleNotFoundError"):
        whole_commands("x", "y", commands={"bad": ("-c", "import no_such_library")})


def test_reference_command_goes_on_from_what_is_there(tmp_path, sessions):
    digest = hashlib.sha256(Path(sessions).read_bytes()).hexdigest()
    stored = stored_reference(digest)
    for name, run in (("own", stored.own), ("other", stored.other)):
        row = {"value": run.value.tolist(), "error": run.error.tolist(), "effective": 6e5}
        file = tmp_path / f"{name}-{digest[:12]}.jsonl"
        file.write_text(f"{json.dumps(row)}\n" * 2, encoding="utf-8")
    found = json.loads(run_reference(tmp_path).read_text(encoding="utf-8"))
    assert found["own"]["effective"] == 1.2e6
    assert found["own"]["value"] == stored.own.value.tolist()
    assert found["sessions_sha256"] == digest


def test_an_engine_nobody_knows_is_wrong_usage(tmp_path, capsys):
    assert main(["bench", "peers", "--engines", "stan", "--out", str(tmp_path / "out")]) == 2
    assert "no such engine; they are percept, percept-stretch" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
