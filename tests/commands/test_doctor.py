import platform
from importlib import metadata

import pytest

from percept import __version__
from percept.cli import main
from percept.commands.maintain import dependency


def test_text_is_five_lines(capsys, monkeypatch):
    monkeypatch.setenv("PERCEPT_CACHE", "off")
    assert main(["doctor"]) == 0
    version, needed, extras, cache, verdict = capsys.readouterr().out.splitlines()
    assert version.startswith(f"percept {__version__}, Python {platform.python_version()}")
    always = sum(dependency(line).extra is None for line in metadata.requires("percept"))
    assert needed == f"needed: {always} of {always} packages are here"
    assert {"test", "cluster"} <= {part.split()[0] for part in extras.removeprefix("extras: ").split("; ")}
    assert cache == "cache: off"
    assert verdict == "Everything percept needs is here."


def test_all_names_every_dependency(capsys):
    assert main(["doctor", "--all"]) == 0
    text = capsys.readouterr().out
    for line in metadata.requires("percept"):
        package = dependency(line)
        assert f"  {package.name:<16}{package.version or 'missing':<14}" in text
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
