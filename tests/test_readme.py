"""Every code block of the README runs as it stands."""

import re
import shlex
from pathlib import Path

import pytest

from percept.cli import main

ROOT = Path(__file__).resolve().parents[1]
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def in_a_copy(tmp_path, monkeypatch):
    (tmp_path / "datasets").symlink_to(ROOT / "datasets")
    monkeypatch.chdir(tmp_path)


COMMANDS = [line for kind, text in BLOCKS if kind == "sh" for line in text.splitlines()]


@pytest.mark.parametrize("line", [line for line in COMMANDS if line.startswith("percept ")])
def test_command_lines_run(line, in_a_copy):
    assert main(shlex.split(line)[1:]) == 0


def test_make_targets_exist():
    targets = {line.split()[1] for line in COMMANDS if line.startswith("make ")}
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert targets
    assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in targets)


PYTHON = [text for kind, text in BLOCKS if kind == "python"]
STATED = re.compile(r"^(\w+\(.*)\s+# ([\d.]+)( k)?", re.MULTILINE)


def test_what_the_comments_state_is_found():
    assert sum(len(STATED.findall(source)) for source in PYTHON) == 3


@pytest.mark.parametrize("source", PYTHON)
def test_python_blocks_run_and_their_comments_hold(source, in_a_copy):
    names = {}
    exec(compile(source, "README.md", "exec"), names)
    for expression, number, kilo in STATED.findall(source):
        value = float(eval(expression, names)) / (1000 if kilo else 1)
        digits = len(number.replace(".", ""))
        assert f"{value:.{digits}g}" == number
