"""Run the tests that take minutes, and write what came of them as a page of `reports`.

    python -m tests.evidence --out reports/evidence

A test marked `evidence` refits many studies, kills commands or sweeps a wide range. With
``reduced=True`` it also runs in `make test`, over fewer cases: `tests.LONG` tells which.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import pytest

import tests
from percept.provenance import made_by

#: Elements of JUnit's format, and what they are called here.
BAD = {"failure": "failed", "error": "failed", "skipped": "skipped"}
_HEAD = """# Evidence

Tests that take minutes: `make evidence` runs them all. `make test` runs some over fewer cases.

"""


def rows_of(results: Path) -> list[str]:
    """Return a row of Markdown per test: file, what it holds, cases, outcome, how long it took.

    `results` is pytest's file of JUnit's format.
    """
    outcomes: dict[tuple[str, str], Counter[str]] = {}
    seconds: Counter[tuple[str, str]] = Counter()
    for case in ElementTree.parse(results).iter("testcase"):
        test = case.attrib["classname"], case.attrib["name"].partition("[")[0]
        outcome = next((child.tag for child in case if child.tag in BAD), "passed")
        outcomes.setdefault(test, Counter())[BAD.get(outcome, outcome)] += 1
        seconds[test] += float(case.attrib["time"])
    rows = []
    for (module, name), counts in sorted(outcomes.items()):
        file = module.removeprefix("tests.").replace(".", "/") + ".py"
        words = name.removeprefix("test_").replace("_", " ")
        told = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))
        rows.append(f"| `{file}` | {words} | {told} | {seconds[module, name]:.0f} |")
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Run the tests, write ``evidence.md``, and return pytest's exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    parser.add_argument("--workers", default="0", help="processes (0: this one)")
    parser.add_argument("tests", nargs="*", default=["tests"], help="files or folders (tests)")
    parsed = parser.parse_args(arguments)
    words = sys.argv[1:] if arguments is None else arguments
    parsed.out.mkdir(parents=True, exist_ok=True)
    results = parsed.out / "evidence.xml"
    options = ["-m", "evidence", "-q", "-n", parsed.workers, "-o", "timeout=3600"]
    options.append(f"--junitxml={results}")
    # Processes of xdist read it when they start; this one has read it.
    os.environ["PERCEPT_EVIDENCE"] = "1"
    tests.LONG = True
    code = pytest.main([*options, *parsed.tests])
    rows = rows_of(results)
    results.unlink()
    sentence = made_by(shlex.join(["python", "-m", "tests.evidence", *words])).sentence
    table = ["| tests/ | what it holds | cases | s |", "|---|---|---|---|", *rows]
    if code:
        sentence += f" pytest ended with exit code {int(code)}: some tests failed, or did not run."
    page = _HEAD + sentence + "\n\n" + "\n".join(table) + "\n"
    (parsed.out / "evidence.md").write_text(page, encoding="utf-8")
    print(parsed.out / "evidence.md")
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
