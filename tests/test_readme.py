"""Every block of README and docs runs as it stands, page by page; what they name exists."""

import argparse
import importlib
import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import pytest

from percept.cache import PosteriorCache, cache_folder
from percept.cli import COMMANDS, build_parser, main
from percept.scene import Scene

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]
#: Run by `make evidence` alone: its examples fit some ten models.
LONG_PAGE = "tasks.md"
RUN_PAGES = [
    pytest.param(page, marks=pytest.mark.evidence if page.name == LONG_PAGE else ())
    for page in PAGES
]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
#: What the line before a block says of a file.
FILE = re.compile(r"(Save this as|Add to) `([\w.]+)`[^`]*\Z")
STATED = re.compile(r"^(.*\S)  # ([\d.]+)( k?)(?:N|SDs)", re.MULTILINE)


@pytest.fixture
def cache(posteriors, monkeypatch):
    """One cache for all pages, so that none samples what another has sampled."""
    monkeypatch.setenv("PERCEPT_CACHE", posteriors)


@pytest.fixture
def in_a_copy(tmp_path, monkeypatch):
    for name in ("datasets", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)


def blocks(page):
    text = page.read_text(encoding="utf-8")
    return [
        (found[1], found[2], text[: found.start()].rstrip()[-200:])
        for found in BLOCK.finditer(text)
    ]


def run_line(line, capsys):
    """Run a line of a shell block, and return what it prints."""
    words = shlex.split(line)
    if words[0] == "make":
        target = words[1] if words[1:] else "install"
        assert re.search(
            rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
        )
    elif words[0] == "percept":
        code = main(words[1:])
        assert code == 0, line
    elif words[0] != "source":
        print(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
    return "".join(capsys.readouterr())


def hold_comments(source, names):
    """Compare the numbers that comments state with what their lines give."""
    for expression, number, kilo in STATED.findall(source):
        value = float(eval(expression, names)) / (1000 if kilo.strip() else 1)
        after_point = len(number.partition(".")[2])
        assert f"{value:.{after_point}f}" == number, expression


@pytest.mark.parametrize("page", RUN_PAGES, ids=lambda page: page.name)
@pytest.mark.usefixtures("cache", "in_a_copy")
def test_every_block_runs(page, capsys):
    names, printed = {}, ""
    for language, text, before in blocks(page):
        file = FILE.search(before)
        if file:
            with Path(file[2]).open(
                "w" if file[1] == "Save this as" else "a", encoding="utf-8"
            ) as there:
                there.write(text)
        elif language == "toml":
            Scene(**tomllib.loads(text))
        elif language == "sh":
            printed = "".join(run_line(line, capsys) for line in text.splitlines())
        elif language == "python":
            exec(compile(text, page.name, "exec"), names)
            hold_comments(text, names)
        else:
            assert language == "text", language
            assert [line for line in text.splitlines() if line not in printed] == []


def test_the_readme_says_what_its_example_renders(tmp_path, monkeypatch):
    files = {
        FILE.search(before)[2]: text for _, text, before in blocks(README) if FILE.search(before)
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    from percept import Study, read_sessions

    scene = Scene.load("scene.toml").with_inference(method="classical")
    rows = Study(read_sessions("walls.csv"), scene).rendering
    assert {row.verdict for row in rows if row.environment == "soft"} == {"can"}
    said = "Through this coupling, soft can be rendered with every hand."
    assert said in README.read_text("utf-8")


@pytest.mark.usefixtures("cache")
def test_the_tutorial_decides_what_its_page_says(tmp_path):
    from percept import Study, read_sessions

    text = (ROOT / "docs" / "tutorial.md").read_text("utf-8")
    scene_text = text.partition("`better.toml`")[2].partition("```toml\n")[2].partition("```")[0]
    path = tmp_path / "better.toml"
    path.write_text(scene_text, encoding="utf-8")
    scene = Scene.load(path).with_inference(tolerance=0.05)
    # The posterior is the one that the tutorial's own command has sampled and kept.
    store = PosteriorCache(cache_folder())
    study = Study(
        read_sessions(ROOT / "docs/tutorial/matching.csv", scene=scene), scene, store=store
    )
    outcomes = {row.environment: row.outcome for row in study.verdict_rows if row.coupled}
    decided = re.search(r"do not render (\w+) and (\w+) with this coupling; test (\w+)", text)
    assert decided is not None
    assert outcomes == {
        decided[1]: "does not",
        decided[2]: "does not",
        decided[3]: "too little data",
    }


def options_of(command):
    parser = build_parser([command])
    commands = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return set(commands.choices[command]._option_string_actions)


@pytest.mark.parametrize(
    "page", [*PAGES, *ROOT.glob("*.md"), *ROOT.glob("*/README.md")], ids=lambda page: page.name
)
def test_commands_named_in_sentences_exist(page):
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    for words in re.findall(r"`percept ([^`]+)`", text):
        command, *rest = words.replace("\n", " ").split()
        if command in ("COMMAND", "help", "-V"):
            continue
        assert command in COMMANDS, words
        assert {word for word in rest if word.startswith("--")} <= options_of(command), words


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_pictures_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8"))
    assert [
        link for link in links if not link.startswith("http") and not (page.parent / link).exists()
    ] == []


def test_extras_named_in_the_readme_exist():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = re.findall(r"pip install '\.\[(\w+)\]'", README.read_text(encoding="utf-8"))
    assert named
    assert set(named) <= set(extras["optional-dependencies"])


def test_the_readme_is_short():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 140


@pytest.mark.parametrize("module", ["scene_reference", "api_reference", "report_reference"])
def test_a_reference_follows_the_code(module, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    reference = importlib.import_module(module)
    page = reference.page()
    assert reference.PAGE.read_text(encoding="utf-8") == page, f"run python docs/{module}.py"
    rows = [row.split(" | ") for row in re.findall(r"^\| `.*", page, re.MULTILINE)]
    assert [row[0] for row in rows if row[-1].strip(" |") == ""] == []
