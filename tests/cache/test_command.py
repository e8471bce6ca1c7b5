import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from percept.cli import main
from tests.cache.test_key import sessions_file

SCENE = """
[device]
mass = 1.0
damping = 5.0
period = 0.001
[coupling]
stiffness = 5e4
damping = 100.0
[frequency]
lower = 1.0
upper = 50.0
points = 7
[inference]
tolerance = 0.2
kinds = ["user"]
"""
# Whether the sampler was imported is asked of the process that did the work.
TOLD = """
import sys
from percept.cli import main
code = main(sys.argv[1:])
print("emcee" in sys.modules)
sys.exit(code)
"""


def report(folder, out, *extra):
    ran = subprocess.run(
        [sys.executable, "-c", TOLD, "report", str(folder / "study.csv"),
         "--scene", str(folder / "scene.toml"), "--out", str(out), "--quiet", *extra],
        capture_output=True, text=True, check=True, env={**os.environ, "PERCEPT_CACHE": str(folder / "kept")},
    )  # fmt: skip
    assert ran.stderr == ""
    return ran.stdout.splitlines()[-1] == "True"


def files(folder):
    skip = {"report.html"}  # has the day it was made on
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*.*") if p.name not in skip
    }


def test_a_report_from_the_cache_is_the_same_in_every_byte_and_imports_no_sampler(tmp_path):
    sessions_file(tmp_path)
    (tmp_path / "scene.toml").write_text(SCENE)
    assert report(tmp_path, tmp_path / "without", "--no-cache")
    assert not (tmp_path / "kept").exists()
    assert report(tmp_path, tmp_path / "first")
    assert not report(tmp_path, tmp_path / "second")
    wanted = files(tmp_path / "without")
    assert "report.json" in wanted
    assert "posterior.nc" in wanted
    for name in ("first", "second"):
        found = files(tmp_path / name)
        assert found.keys() == wanted.keys()
        different = [file for file in wanted if found[file] != wanted[file]]
        assert set(different) <= {"report.sha256"}  # which lists the page too


def test_show_and_clear(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PERCEPT_CACHE", str(tmp_path / "kept"))
    path = sessions_file(tmp_path)
    wanted = ["fit", str(path), "--tolerance", "0.3", "--quiet", "--out", str(tmp_path / "out")]
    assert main(wanted) == 0
    capsys.readouterr()
    assert main(["cache", "--json"]) == 0
    state = json.loads(capsys.readouterr().out)
    assert state["folder"] == str(tmp_path / "kept")
    (entry,) = state["entries"]
    assert entry["bytes"] == state["bytes"] == next(Path(state["folder"]).iterdir()).stat().st_size
    assert main(["cache"]) == 0
    shown = capsys.readouterr().out
    assert "1 posteriors" in shown
    assert entry["key"][:16] in shown
    assert main(["cache", "clear"]) == 0
    assert "1 posteriors removed" in capsys.readouterr().out
    assert list((tmp_path / "kept").iterdir()) == []
    assert main(["cache", "clear", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["removed"] == 0


@pytest.mark.parametrize("action", ["show", "clear"])
def test_a_cache_that_is_off_is_said(monkeypatch, capsys, action):
    monkeypatch.setenv("PERCEPT_CACHE", "off")
    assert main(["cache", action]) == 2
    assert "turned off" in capsys.readouterr().err
