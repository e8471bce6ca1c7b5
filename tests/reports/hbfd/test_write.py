import cmath
import json
import re
from pathlib import Path

import pytest

from reports.hbfd.published import load_published
from reports.hbfd.write import PAGE, symbols

COMMITTED = Path(__file__).resolve().parents[3] / "reports" / "hbfd"


@pytest.fixture(scope="module")
def document(written):
    return json.loads((written / "claims.json").read_text(encoding="utf-8"))


def same(found, wanted, place=""):
    """Equal, numbers to nine digits, whatever library versions made them."""
    if isinstance(wanted, dict):
        assert found.keys() == wanted.keys(), place
        for key in wanted:
            same(found[key], wanted[key], f"{place}/{key}")
    elif isinstance(wanted, list):
        assert len(found) == len(wanted), place
        for index, (one, other) in enumerate(zip(found, wanted, strict=True)):
            same(one, other, f"{place}/{index}")
    elif isinstance(wanted, float) and not isinstance(found, str):
        assert found == pytest.approx(wanted, rel=1e-9, abs=1e-12), place
    else:
        assert found == wanted, place


def test_the_committed_report_is_what_the_command_writes(document):
    wanted = json.loads((COMMITTED / "claims.json").read_text(encoding="utf-8"))
    for one in (document, wanted):
        del one["provenance"]["versions"]
    same(document, wanted)


def test_counts_are_of_the_claims(document):
    verdicts = [claim["verdict"] for claim in document["claims"]]
    assert document["counts"] == {name: verdicts.count(name) for name in document["counts"]}
    assert sum(document["counts"].values()) == len(verdicts) == 39


def test_the_page_shows_every_claim_and_its_numbers(written, document):
    page = (written / PAGE).read_text(encoding="utf-8")
    shown = set(re.findall(r'<data value="([^"]*)"', page))
    for claim in document["claims"]:
        assert f'id="claim-{claim["name"]}"' in page
        for one in filter(None, (claim["margin"], *claim["numbers"])):
            assert {
                str(one["value"]),
                str(int(one["value"])) if one["value"] == int(one["value"]) else "",
            } & shown


def test_the_page_needs_nothing_else(written):
    page = (written / PAGE).read_text(encoding="utf-8")
    assert len(page.encode()) < 3_000_000
    # Beside a figure stands a link to its file; the page shows the figure without it.
    assert not re.search(r'(?<!class="file" )(src|href)="(?!#)', page)
    assert "<script" not in page
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    for target in re.findall(r'href="#([^"]+)"', page):
        assert target in ids


def test_every_figure_is_a_file_and_on_the_page(written):
    page = (written / PAGE).read_text(encoding="utf-8")
    names = {path.stem for path in (written / "figures").iterdir()}
    panels = {f"fig-7{letter}" for letter in "abcdef"}
    assert names == panels | {"fig-4", "fig-5"}
    for name in names:
        assert f'id="figure-{name}"' in page


def test_the_table_is_written_digit_for_digit(document):
    rows = document["table"]
    assert len(rows) == 10
    for row in rows:
        assert (row["lower"], row["upper"]) == (row["lower_printed"], row["upper_printed"])
    free = next(row for row in rows if (row["environment"], row["parameter"]) == ("VE1", "b"))
    # Mean 0.68455 and SD 0.63147, prediction 3.40846 SDs.
    assert free["user"][1] == pytest.approx(0.68455 + 3.40846 * 0.63147, abs=2e-4)


def test_sentences_that_no_number_could_refute_are_left_open(written, document):
    page = (written / PAGE).read_text(encoding="utf-8")
    left = [claim for claim in document["claims"] if claim["verdict"] == "cannot be judged"]
    assert [claim["name"] for claim in left] == [
        "worst-case",
        "friction-ignored",
        "limits-suffice",
        "normal-values",
        "table-1",
        "resonance-peaks",
        "one-device",
        "perception-limited",
        "users-unreal",
    ]
    assert page.count("from published numbers; needed:") == len(left)


def test_misprints_have_a_list_of_their_own(written, document, published):
    page = (written / PAGE).read_text(encoding="utf-8")
    by_place = {one["place"]: one for one in document["misprints"]}
    assert list(by_place) == ["Section 2.2, Eqs 5 and 7", "Section 2.3", "Section 4", "Section 6"]
    assert 'id="misprints"' in page
    # Section 4 as printed, k_e and b_e: very low, low, low again, medium, high, very high.
    text = [(10, 0.1), (10, 0.1), (1000, 1), (10000, 10), (25000, 25), (50000, 50)]
    assert {(wall.k, wall.b) for wall in published.walls} == set(text)
    assert "all five environments of Table 1, in six cases" in by_place["Section 4"]["finding"]
    z = cmath.exp(0.01j)
    printed, meant = abs(2000 * (z - 1 / z + 1)), abs(2000 * (z - 1) / (z + 1))
    assert (
        f"|s| = {printed:.4g} 1/s. Eq. 12’s gives {meant:.6g} 1/s"
        in by_place["Section 2.2, Eqs 5 and 7"]["finding"]
    )
    s = 2000 * (z - 1) / (z + 1)
    z_e = 0.1 + 10 / s
    ratio = abs(s + 5 + (z + 1) / (2 * z) * z_e) / abs(z_e)
    assert f"{ratio:.3g} times |Z_e|" in by_place["Section 6"]["finding"]


def test_names_of_the_table_are_text_on_the_page(published, claims):
    assert (
        symbols("<b>VE</b> Z_h_vc b_d k_cT Z_eff, -0.5 to 99%")
        == "&lt;b&gt;VE&lt;/b&gt; Z<sub>h,vc</sub> b<sub>d</sub> k<sub>c</sub>T Z<sub>eff</sub>,"
        " −0.5 to 99 %"
    )


def test_the_paper_is_read_by_default(published):
    found = load_published()
    assert [path.name for path in found.files] == ["hbfd_table1.csv", "hbfd.toml"]
    assert found.limits.environments == ("VE1", "VE2", "VE3", "VE4", "VE5")
