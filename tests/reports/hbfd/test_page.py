"""The page holds every claim with its numbers, and the committed one is what the code writes."""

import cmath
from pathlib import Path

import pytest

from reports.hbfd.judging import misprints
from reports.hbfd.page import page, table_rows

COMMITTED = Path(__file__).resolve().parents[3] / "reports" / "hbfd" / "hbfd.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("hbfd")


@pytest.fixture(scope="module")
def text(folder):
    return page(folder).text


def test_the_committed_page_is_what_the_command_writes(text):
    made = COMMITTED.read_text(encoding="utf-8")
    # What it was made by, and when, comes last.
    assert made.startswith(text)
    assert made[len(text) :].strip().startswith("Made on ")


def test_every_figure_is_a_file_and_on_the_page(text, folder):
    names = {path.name for path in (folder / "figures").iterdir()}
    assert names == {"fig-4.svg", "fig-5.svg", *(f"fig-7{letter}.svg" for letter in "abcdef")}
    assert all(f"(figures/{name})" in text for name in names)


def test_the_table_is_written_digit_for_digit(published):
    rows = list(table_rows(published))
    assert len(rows) == 10
    for row in rows:
        assert row[5:7] == row[3:5]
    (free,) = [row for row in rows if row[:2] == ["VE1", "b"]]
    # Mean 0.68455 and SD 0.63147, prediction 3.40846 SDs.
    assert float(free[7].split(" to ")[1]) == pytest.approx(0.68455 + 3.40846 * 0.63147, abs=2e-4)


def test_misprints_have_a_list_of_their_own(text, published):
    by_place = {one["place"]: one for one in misprints()}
    assert list(by_place) == ["Section 2.2, Eqs 5 and 7", "Section 2.3", "Section 4", "Section 6"]
    assert all(one["finding"].replace("|", r"\|") in text for one in by_place.values())
    # Section 4 as printed, k_e and b_e: very low, low, low again, medium, high, very high.
    printed = [(10, 0.1), (10, 0.1), (1000, 1), (10000, 10), (25000, 25), (50000, 50)]
    assert {(wall.k, wall.b) for wall in published.walls} == set(printed)
    assert "all five environments of Table 1, in six cases" in by_place["Section 4"]["finding"]
    z = cmath.exp(0.01j)
    wrong, meant = abs(2000 * (z - 1 / z + 1)), abs(2000 * (z - 1) / (z + 1))
    assert (
        f"|s| = {wrong:.4g} 1/s. Eq. 12’s gives {meant:.6g} 1/s"
        in by_place["Section 2.2, Eqs 5 and 7"]["finding"]
    )
    s = 2000 * (z - 1) / (z + 1)
    z_e = 0.1 + 10 / s
    ratio = abs(s + 5 + (z + 1) / (2 * z) * z_e) / abs(z_e)
    assert f"{ratio:.3g} times |Z_e|" in by_place["Section 6"]["finding"]
