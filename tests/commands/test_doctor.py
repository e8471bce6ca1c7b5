import platform
from importlib import metadata

import pytest

from percept import __version__
from percept.cli import main


def test_five_lines_say_what_is_here(capsys, monkeypatch):
    monkeypatch.setenv("PERCEPT_CACHE", "off")
    lines = [
        "numpy>=1",
        "scipy>=1",
        "dask>=1; extra == 'cluster'",
        "surely-not>=2; extra == 'cluster'",
    ]
    monkeypatch.setattr(metadata, "requires", lambda _: lines)
    assert main(["doctor"]) == 0
    version, needed, extras, cache, verdict = capsys.readouterr().out.splitlines()
    assert version.startswith(f"percept {__version__}, Python {platform.python_version()}")
    assert needed == "needed: 2 of 2 packages are here"
    assert extras == "extras: cluster lacks surely-not>=2"
    assert cache == "cache: off"
    assert verdict == "Everything percept needs is here."


def test_what_is_installed_here_is_enough(capsys):
    assert main(["doctor"]) == 0
    count = sum("extra ==" not in line for line in metadata.requires("percept-haptics"))
    assert f"needed: {count} of {count} packages are here" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "broken"),
    [
        ("surely-not-a-package>=1", "surely-not-a-package>=1"),
        ("numpy>=999", "numpy>=999"),
        ("surely-not-a-package>=1; extra == 'cluster'", None),
        ("arviz-stats[xarray]>=0.1", None),
    ],
    ids=["missing", "too old", "missing and optional", "with extras"],
)
def test_what_is_missing_or_too_old_is_told(line, broken, monkeypatch, capsys):
    monkeypatch.setattr(metadata, "requires", lambda _: [line])
    assert main(["doctor"]) == int(broken is not None)
    printed = capsys.readouterr().out
    if "extra" in line:
        assert "extras: cluster lacks surely-not-a-package>=1" in printed
    if broken:
        assert f'Install {broken}: python -m pip install "{broken}"' in printed
    else:
        assert "Install" not in printed


def test_the_stranger_of_the_same_name_is_recognised(tmp_path, monkeypatch, capsys):
    """The package index has a project `percept` of its own: its files replace ours."""
    info = tmp_path / "percept-0.14.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: percept\nVersion: 0.14\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["doctor"]) == 1
    printed = capsys.readouterr().out
    assert "Another project's package 'percept' is installed here" in printed
    assert "python -m pip uninstall percept." in printed
    assert "Everything percept needs is here." not in printed
