import stat
from pathlib import Path

from percept.browser import find_browser


def program(folder, name):
    path = folder / name
    path.write_text("#!/bin/sh\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_a_browser_on_the_path_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("PERCEPT_BROWSER", raising=False)
    assert find_browser() is None
    found = program(tmp_path, "chromium")
    assert Path(find_browser()) == found


def test_the_one_that_is_named_goes_before_those_on_the_path(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    program(tmp_path, "chromium")
    mine = program(tmp_path, "my-browser")
    monkeypatch.setenv("PERCEPT_BROWSER", str(mine))
    assert Path(find_browser()) == mine
    monkeypatch.setenv("PERCEPT_BROWSER", str(tmp_path / "nowhere"))
    assert find_browser() is None
