"""What made a page: the last commit of the code, and whether files differ from it."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from percept import provenance
from percept.provenance import Made, commit_of_code, made_by

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(path for path in (ROOT / "reports").glob("*/*") if path.suffix in (".md", ".html"))
needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="needs git")


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A repository of its own, with one commit of a package."""
    package = tmp_path / "package"
    package.mkdir()
    (package / "code.py").write_text("1\n")
    monkeypatch.setattr(provenance, "_PACKAGE", package)

    def git(*words):
        who = ("-c", "user.name=A", "-c", "user.email=a@b.c")
        done = subprocess.run(
            ["git", *who, *words], cwd=tmp_path, capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    git("init")
    git("add", ".")
    git("commit", "-m", "code")
    return git


@needs_git
def test_the_commit_is_the_last_that_touched_the_package(package, tmp_path):
    commit = package("rev-parse", "--short=12", "HEAD")
    (tmp_path / "page.md").write_text("page\n")
    package("add", ".")
    package("commit", "-m", "a page")
    assert commit_of_code() == commit
    (tmp_path / "package" / "code.py").write_text("2\n")
    assert commit_of_code() == f"{commit} with changes"


def test_without_a_repository_there_is_no_commit(tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "_PACKAGE", tmp_path / "package")
    assert commit_of_code() == ""
    made = made_by("percept plan", ("numpy", "nothing-of-this-name"))
    assert list(made.versions) == ["percept", "Python", "numpy"]


def test_all_of_it_in_a_sentence():
    made = Made("percept plan", "2024-05-01", "abc", {"percept": "1", "numpy": "2"})
    assert (
        made.sentence == "Made on 2024-05-01 by `percept plan` from commit abc. percept 1, numpy 2."
    )


@needs_git
@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_committed_pages_name_a_commit_of_the_history(page):
    text = page.read_text(encoding="utf-8")
    (commit,) = set(re.findall(r"from commit ([0-9a-f]{7,40})(?! with changes)\b", text))
    found = subprocess.run(
        ["git", "merge-base", "--is-ancestor", commit, "HEAD"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    if b"shallow" in found.stderr or not (ROOT / ".git").exists():
        pytest.skip("needs the whole history")
    assert found.returncode == 0, commit
