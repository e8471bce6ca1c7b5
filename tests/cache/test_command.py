import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from percept import Scene, Study, read_sessions
from percept.cache import PosteriorCache
from percept.cli import main
from percept.results import dumps
from tests.batch.conftest import study_text
from tests.documents import build_document

SCENE = {
    "device": {"mass": 1.0, "damping": 5.0, "period": 0.001},
    "frequency": {"lower": 1.0, "upper": 50.0, "points": 3},
    "inference": {"tolerance": 0.5, "kinds": ["user"], "method": "bayesian"},
}
# Each document is made by a process that did nothing else, as a command is: the last bits of a sum
# may depend on where its numbers stand in memory.
MADE = """
import sys
from pathlib import Path
from tests.cache.test_command import document
from percept.cache import PosteriorCache
sys.stdout.buffer.write(document(Path(sys.argv[1]), PosteriorCache(Path(sys.argv[2]))))
"""
FOUND = MADE + 'assert "emcee" not in sys.modules, "the sampler was imported"'


def run(code, path, store):
    """Run code on sessions and a cache, and return what it wrote."""
    root = Path(__file__).resolve().parents[2]
    words = [sys.executable, "-c", code, str(path), str(store.folder)]
    done = subprocess.run(words, cwd=root, capture_output=True, check=False)
    assert done.stderr == b""
    return done.stdout


def document(path, store):
    """Give the bytes of report.json."""
    study = Study(read_sessions(path), Scene(**SCENE), store=store)
    return dumps(build_document(study)).encode()


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Sessions, the cache that keeps their posterior, and their document."""
    folder = tmp_path_factory.mktemp("kept")
    path, store = folder / "study.csv", PosteriorCache(folder / "kept")
    path.write_text(study_text(1, subjects=4))
    return path, store, run(MADE, path, store)


def test_report_json_is_the_same_in_every_byte_from_the_cache_which_imports_no_sampler(kept):
    path, store, computed = kept
    assert len(store.entries()) == 1
    assert run(FOUND, path, store) == computed
    assert b'"passed": true' in computed


def test_show_and_clear(kept, tmp_path, monkeypatch, capsys):
    folder = tmp_path / "kept"
    shutil.copytree(kept[1].folder, folder)
    monkeypatch.setenv("PERCEPT_CACHE", str(folder))
    (entry,) = folder.iterdir()
    assert main(["doctor", "--cache", "show"]) == 0
    said = f"{folder}: 1 posterior, {entry.stat().st_size / 1e6:.1f} of 1000 MB\n"
    assert capsys.readouterr().out == said
    assert main(["doctor", "--cache", "clear"]) == 0
    assert "1 posterior removed" in capsys.readouterr().out
    assert list(folder.iterdir()) == []
    assert main(["doctor", "--cache", "clear"]) == 0
    assert "0 posteriors removed" in capsys.readouterr().out


@pytest.mark.parametrize("action", ["show", "clear"])
def test_a_cache_that_is_off_is_said(monkeypatch, capsys, action):
    monkeypatch.setenv("PERCEPT_CACHE", "off")
    assert main(["doctor", "--cache", action]) == 2
    assert "turned off. Unset it, or let it name a folder." in capsys.readouterr().err


@pytest.mark.parametrize("action", ["show", "clear"])
def test_a_file_in_the_place_of_the_cache_is_said(tmp_path, monkeypatch, capsys, action):
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    monkeypatch.setenv("PERCEPT_CACHE", str(path))
    assert main(["doctor", "--cache", action]) == 2
    assert f"{path}: a folder is needed here, and this is a file." in capsys.readouterr().err
    assert path.read_text() == "mine"
