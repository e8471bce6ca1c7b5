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

import pytest

import tests
from percept.provenance import made_by

_HEAD = """# Evidence

Tests that take minutes: `make evidence` runs them all. `make test` runs some over fewer cases.

"""


class Results:
    """What pytest tells of each test, here or on a worker of xdist."""

    def __init__(self) -> None:
        self.reports: dict[str, list[pytest.TestReport]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep set-up, call and tear-down of each test."""
        self.reports.setdefault(report.nodeid, []).append(report)

    def rows(self) -> list[str]:
        """A row of Markdown per test: file, what it holds, cases, outcome, and how long it took."""
        tests: dict[str, list[list[pytest.TestReport]]] = {}
        for case, reports in self.reports.items():
            tests.setdefault(case.partition("[")[0], []).append(reports)
        rows = []
        for test, cases in sorted(tests.items()):
            file, _, name = test.partition("::")
            words = name.removeprefix("test_").replace("_", " ")
            outcomes = Counter(map(_outcome, cases))
            told = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
            seconds = sum(report.duration for reports in cases for report in reports)
            rows.append(f"| `{file.removeprefix('tests/')}` | {words} | {told} | {seconds:.0f} |")
        return rows


def _outcome(reports: list[pytest.TestReport]) -> str:
    """Say what a case came to: the worst of its set-up, call and tear-down."""
    outcomes = {report.outcome for report in reports}
    for bad in ("failed", "skipped"):
        if bad in outcomes:
            return bad
    finished = any(report.when == "call" for report in reports)
    return "passed" if finished else "not finished"


def main(arguments: list[str] | None = None) -> int:
    """Run the tests, write ``evidence.md``, and return pytest's exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    parser.add_argument("--workers", default="0", help="processes (0: this one)")
    parser.add_argument("tests", nargs="*", default=["tests"], help="files or folders (tests)")
    parsed = parser.parse_args(arguments)
    words = sys.argv[1:] if arguments is None else arguments
    results = Results()
    options = ["-m", "evidence", "-q", "-n", parsed.workers, "-o", "timeout=3600"]
    # Processes of xdist read it when they start; this one has read it.
    os.environ["PERCEPT_EVIDENCE"] = "1"
    tests.LONG = True
    code = pytest.main([*options, *parsed.tests], plugins=[results])
    rows = results.rows()
    sentence = made_by(shlex.join(["python", "-m", "tests.evidence", *words])).sentence
    table = ["| tests/ | what it holds | cases | s |", "|---|---|---|---|", *rows]
    parsed.out.mkdir(parents=True, exist_ok=True)
    if code:
        sentence += f" pytest ended with exit code {int(code)}: some tests failed, or did not run."
    page = _HEAD + sentence + "\n\n" + "\n".join(table) + "\n"
    (parsed.out / "evidence.md").write_text(page, encoding="utf-8")
    print(parsed.out / "evidence.md")
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
