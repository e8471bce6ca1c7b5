"""Engines and whole commands in processes of their own, and the parts of the benchmark that run
them."""

import importlib.util
import json
import shutil

import pytest

from percept.errors import RefusalError
from reports.benchmark.__main__ import main
from reports.benchmark.peers.processes import whole_commands
from tests import BENCHMARK


def test_commands_take_turns_and_are_timed(tmp_path):
    log = tmp_path / "log"
    note = (
        "import os, sys; open(sys.argv[1], 'a').write(sys.argv[2] + os.environ['PERCEPT_CACHE'] +"
        " ' ')"
    )
    work = note + "; sum(range(6_000_000))"
    commands = {"note": ("-c", note, "SESSIONS", "a"), "work": ("-c", work, "SESSIONS", "b")}
    light, heavy = whole_commands(str(log), "scene.toml", repeats=2, commands=commands)
    assert log.read_text() == "aoff boff " * 3
    assert light.command.startswith("python -c 'import os, sys")
    assert len(light.seconds) == 2
    # Both start an interpreter; only one of them works.
    assert heavy.processor > light.processor
    assert heavy.median == pytest.approx(sum(heavy.seconds) / 2)


def test_a_command_that_fails_is_named():
    with pytest.raises(RefusalError, match="-c import no_such_library failed: ModuleNotFoundError"):
        whole_commands("x", "y", repeats=1, commands={"bad": ("-c", "import no_such_library")})


def test_an_engine_nobody_knows_is_wrong_usage(tmp_path, capsys):
    assert main(["peers", "--engines", "stan", "--out", str(tmp_path / "out")]) == 2
    assert "no such engine; they are percept, emcee" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


without_peers = pytest.mark.skipif(
    importlib.util.find_spec("pymc") is not None,
    reason="the extra percept-haptics[peers] is installed",
)


@pytest.mark.evidence
@without_peers
def test_what_is_not_installed_is_left_out_and_its_extra_named(tmp_path, capsys):
    shutil.copy(BENCHMARK / "reference.json", tmp_path)
    words = ["--engines", "percept", "nutpie", "--rows", "published", "--quick", "--repeats", "0"]
    assert main(["peers", *words, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().err
    assert "nutpie, written plainly: left out, nutpie, pymc" in said
    assert "pip install 'percept-haptics[peers]'" in said
    found = json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in found["engines"]] == ["percept"]
    assert list(found["left_out"]) == ["nutpie, written plainly"]
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert (
        "Left out, since packages are not installed here: nutpie, written plainly (nutpie" in text
    )


@pytest.mark.evidence
@without_peers
def test_a_whole_quick_benchmark_of_what_is_installed(tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    shutil.copy(BENCHMARK / "reference.json", out)
    words = [
        "peers",
        "--engines",
        "percept",
        "nutpie",
        "emcee",
        "--quick",
        "--out",
        str(out),
    ]
    words += ["--rows", "published"]
    assert main(words) == 0
    said = capsys.readouterr().err
    assert "nutpie, written plainly: left out, nutpie, pymc" in said
    assert "pip install 'percept-haptics[peers]'" in said
    found = json.loads((out / "benchmark.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in found["engines"]] == ["percept", "emcee"]
    assert list(found["left_out"]) == ["nutpie, written plainly", "import pymc"]
    assert [one["name"] for one in found["whole"]] == [
        "import what percept fit needs", "percept fit, classical",
    ]  # fmt: skip
    text = (out / "index.html").read_text(encoding="utf-8")
    assert (
        "Left out, since packages are not installed here: nutpie, written plainly (nutpie" in text
    )
    assert [one["name"] for one in found["studies"]] == ["published"]
    ours, row = found["measured"]
    # emcee's stretch moves, far too short: an error that is shown, not agreement.
    assert (row["engine"], row["repeats"]) == ("emcee", 1)
    assert row["error"] > 2.0 * ours["error"]
    assert ours["error"] < 0.1
    assert ours["agreement"] < 3.0


@without_peers
def test_nothing_installed_is_refused(tmp_path, capsys):
    assert main(["peers", "--engines", "nutpie", "--out", str(tmp_path / "out")]) == 1
    assert "none of these engines is installed" in capsys.readouterr().err
