import json
import platform
from importlib import metadata

import numpy
import pytest

from percept import __version__
from percept.cli import main
from percept.commands.maintain import dependency


def test_json_says_what_is_installed(capsys):
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["percept"] == __version__
    assert found["python"] == platform.python_version()
    assert found["complete"] is True
    by_name = {(one["name"], one["extra"]): one for one in found["dependencies"]}
    assert by_name["numpy", None]["version"] == numpy.__version__
    assert by_name["numpy", None]["fits"] is True
    assert by_name["hypothesis", "test"]["wanted"].startswith(">=")


def test_text_is_five_lines(capsys):
    assert main(["doctor"]) == 0
    version, needed, extras, browser, verdict = capsys.readouterr().out.splitlines()
    assert version.startswith(f"percept {__version__}, Python {platform.python_version()}")
    always = sum(dependency(line).extra is None for line in metadata.requires("percept"))
    assert needed == f"needed: {always} of {always} packages are here"
    assert {"test", "cluster"} <= {part.split()[0] for part in extras.removeprefix("extras: ").split("; ")}
    assert browser.startswith("browser: ")
    assert verdict == "Everything percept needs is here."


def test_all_names_every_dependency(capsys):
    assert main(["doctor", "--all"]) == 0
    text = capsys.readouterr().out
    for line in metadata.requires("percept"):
        assert dependency(line).name in text
    assert "Everything percept needs is here." in text


@pytest.mark.parametrize(
    ("line", "extra", "fits"),
    [
        ("surely-not-a-package>=1", None, False),
        ("numpy>=999", None, False),
        ("surely-not-a-package>=1; extra == 'cluster'", "cluster", False),
        ("arviz-stats[xarray]>=0.1", None, True),
    ],
    ids=["missing", "too old", "missing and optional", "with extras"],
)
def test_what_is_missing_or_too_old_is_told(line, extra, fits, monkeypatch, capsys):
    found = dependency(line)
    assert (found.extra, found.fits) == (extra, fits)
    assert found.name == line.partition(">=")[0].partition("[")[0]
    monkeypatch.setattr(metadata, "requires", lambda _: [line])
    broken = not fits and extra is None
    assert main(["doctor"]) == int(broken)
    assert (f"Install {found.name}: python -m pip install" in capsys.readouterr().out) is broken
