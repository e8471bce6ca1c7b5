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
from pathlib import Path

import pytest

from percept.provenance import made_by

_HEAD = """# Evidence

Tests that take minutes: `make evidence` runs them all. `make test` runs some of them over fewer cases.

"""


class Results:
    """What pytest tells of each test, here or on a worker of xdist."""

    def __init__(self) -> None:
        self.reports: dict[str, list[pytest.TestReport]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep set-up, call and tear-down of each test."""
        self.reports.setdefault(report.nodeid, []).append(report)

    def rows(self) -> list[str]:
        """A row of Markdown per test: its file, what it holds, the outcome, and how long it took."""
        rows = []
        for test, reports in sorted(self.reports.items()):
            file, _, name = test.partition("::")
            words = name.removeprefix("test_").replace("_", " ").replace("|", "\\|")
            outcomes = {report.outcome for report in reports}
            outcome = next((bad for bad in ("failed", "skipped") if bad in outcomes), "passed")
            seconds = sum(report.duration for report in reports)
            rows.append(
                f"| `{file.removeprefix('tests/')}` | {words} | {outcome} | {seconds:.0f} |"
            )
        return rows


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
    # Processes of xdist and of the commands under test take it over.
    os.environ["PERCEPT_EVIDENCE"] = "1"
    code = pytest.main([*options, *parsed.tests], plugins=[results])
    rows = results.rows()
    sentence = made_by(shlex.join(["python", "-m", "tests.evidence", *words])).sentence
    table = ["| tests/ | what it holds | outcome | s |", "|---|---|---|---|", *rows]
    parsed.out.mkdir(parents=True, exist_ok=True)
    page = _HEAD + sentence + "\n\n" + "\n".join(table) + "\n"
    (parsed.out / "evidence.md").write_text(page, encoding="utf-8")
    print(parsed.out / "evidence.md")
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
