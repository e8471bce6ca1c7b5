import platform
from importlib import metadata

import pytest
from packaging.requirements import Requirement

from percept import __version__
from percept.cli import main


def test_every_dependency_is_named_with_its_version(capsys, monkeypatch):
    monkeypatch.setenv("PERCEPT_CACHE", "off")
    assert main(["doctor"]) == 0
    version, cache, *packages, verdict = capsys.readouterr().out.splitlines()
    assert version.startswith(f"percept {__version__}, Python {platform.python_version()}")
    assert cache == "cache: off"
    assert [line.split(maxsplit=1)[1] for line in packages] == [
        str(Requirement(line)) for line in metadata.requires("percept")
    ]
    assert any(line.startswith(f"  {metadata.version('numpy')} ") and "numpy" in line for line in packages)
    assert verdict == "Everything percept needs is here."


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
    assert ("missing" in printed) is line.startswith("surely")
    if broken:
        assert f'Install {broken}: python -m pip install "{broken}"' in printed
    else:
        assert "Install" not in printed
