"""The page holds every claim with its numbers, and the committed one is what the code writes."""

from pathlib import Path

import pytest

from reports.hbfd.page import figures, page, table_rows

COMMITTED = Path(__file__).resolve().parents[3] / "reports" / "hbfd" / "hbfd.md"


@pytest.mark.evidence
def test_the_committed_page_is_what_the_command_writes(tmp_path):
    """`make test` holds its claims and numbers: see test_claims and below."""
    text = page(tmp_path).text
    made = COMMITTED.read_text(encoding="utf-8")
    # What it was made by, and when, comes last.
    assert made.startswith(text)
    assert made[len(text) :].strip().startswith("Made on ")


def test_every_figure_is_a_file_and_on_the_page(published):
    names = {f"{name}.svg" for name, _, _ in figures(published)}
    assert names == {"fig-4.svg", "fig-5.svg", *(f"fig-7{letter}.svg" for letter in "abcdef")}
    assert names == {path.name for path in (COMMITTED.parent / "figures").iterdir()}
    text = COMMITTED.read_text(encoding="utf-8")
    assert all(f"(figures/{name})" in text for name in names)


def test_the_table_is_written_digit_for_digit(published):
    rows = list(table_rows(published))
    assert len(rows) == 10
    text = COMMITTED.read_text(encoding="utf-8")
    for row in rows:
        assert f"| {' | '.join(row)} |" in text
        assert row[5:7] == row[3:5]
    (free,) = [row for row in rows if row[:2] == ["VE1", "b"]]
    # Mean 0.68455 and SD 0.63147, prediction 3.40846 SDs.
    assert float(free[7].split(" to ")[1]) == pytest.approx(0.68455 + 3.40846 * 0.63147, abs=2e-4)
