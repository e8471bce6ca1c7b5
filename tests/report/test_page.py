from __future__ import annotations

import base64
import copy
import hashlib
import re
from html.parser import HTMLParser

import pandas as pd
import pytest

from percept import Study, read_sessions
from percept.report.basics import Plot, written
from percept.sessions import Sessions
from tests.documents import build_document, page_of, parts_of, sections_of
from tests.fits import SHARED
from tests.unmixed import UNMIXED, unmixed_sessions

from .conftest import DATASETS, scene_of

STYLES = [("plain", digits) for digits in range(2, 7)] + [("percent", digits) for digits in (2, 3)]
STYLES += [("difference", digits) for digits in range(2, 7)]
STYLES += [(style, 5) for style in ("short", "count", "bias")]
HOSTILE = '"><img src=x onerror=alert(1)>{{7*7}}</script>'


class Reader(HTMLParser):
    """What a page says: numbers with their texts, text of table cells, tags and attributes."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.numbers, self.cells, self.tags, self.text = [], [], [], []
        self._open, self._cell, self._inside = None, None, []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append((tag, attributes))
        self._inside.append(tag)
        if tag == "data":
            self._open = [attributes["value"], ""]
        if tag in ("td", "th"):
            self._cell = {"tag": tag, "bare": "", "class": attributes.get("class", "")}

    def handle_endtag(self, tag):
        if tag == "data":
            self.numbers.append(tuple(self._open))
            self._open = None
        if tag in ("td", "th") and self._cell:
            self.cells.append(self._cell)
            self._cell = None
        while self._inside and self._inside.pop() != tag:
            pass

    def handle_data(self, data):
        if self._inside and self._inside[-1] not in ("script", "style"):
            self.text.append(data)
        if self._open:
            self._open[1] += data
        elif self._cell:
            self._cell["bare"] += data


@pytest.fixture(scope="module")
def page(report):
    return (report / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def read(page):
    return Reader(page)


def numbers_of(value):
    """Every number of a document."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return {number for part in value for number in numbers_of(part)}
    if value in ("inf", "-inf"):
        return {float(value)}
    return set() if isinstance(value, (str, bool, type(None))) else {value}


def test_every_number_is_one_of_report_json_or_a_bias_of_it(read, both):
    known = numbers_of(both)
    for row in both["intervals"]:
        known |= {row[name] / row["reference"] - 1.0 for name in ("lower", "estimate", "upper")}
    assert len(read.numbers) > 400
    for exact, text in read.numbers:
        value = float(exact) if re.search(r"[.e]|inf", exact) else int(exact)
        assert value in known, exact
        styles = [one for one in STYLES if one[0] != "count" or isinstance(value, int)]
        styles += [("ratio", 3)] if abs(value) < 100 else []  # Of a logarithm
        assert text in {written(value, digits, style) for style, digits in styles}, exact


def test_no_table_shows_a_number_that_is_not_in_report_json(read):
    bare = [cell for cell in read.cells if cell["tag"] == "td" and "text" not in cell["class"]]
    assert len(bare) > 200
    for cell in bare:
        assert not re.search(r"\d", cell["bare"]), cell


def test_nothing_is_fetched_and_files_it_names_stand_beside_it(report, page, read):
    for tag, attributes in read.tags:
        for name in ("src", "href", "xlink:href", "srcset", "data", "action"):
            beside = name == "href" and tag == "a" and (report / attributes.get(name, "#")).exists()
            assert beside or attributes.get(name, "#").startswith(("#", "data:")), (tag, attributes)
    assert "@import" not in page
    assert not re.search(r"url\((?!#)", page)


def test_ids_are_unique_and_links_lead_somewhere(read):
    ids = [attributes["id"] for _, attributes in read.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in read.tags:
        for name in ("href", "xlink:href"):
            if attributes.get(name, "").startswith("#"):
                assert attributes[name][1:] in ids
        for one in attributes.get("aria-labelledby", "").split():
            assert one in ids


def test_the_page_differs_in_its_date_only(both):
    one, other = (page_of(both, date=date) for date in ("2026-01-01", "2027-02-03"))
    assert one != other
    assert one.replace("2026-01-01", "2027-02-03") == other


def renamed(document, name):
    """The document with VE1 called otherwise."""
    document = copy.deepcopy(document)
    parts = [document[part] for part in ("intervals", "boundaries")]
    for part in (*parts, document["data"]["cells"]):
        for row in part:
            row["environment"] = name if row["environment"] == "VE1" else row["environment"]
    document["impedances"][name] = document["impedances"].pop("VE1")
    for row in (*document["coupling"]["memberships"], *document["verdicts"]):
        row["environment"] = name if row["environment"] == "VE1" else row["environment"]
    document["data"]["environments"] = [name, *document["data"]["environments"][1:]]
    document["data"]["notices"] = [{"text": name, "file": name, "row": 3}]
    document["data"]["exclusions"] = [
        {"who": name, "what": name, "why": name, "file": name, "row": 3}
    ]
    document["provenance"]["files"][0]["name"] = name
    document["skipped"] = [{"what": name, "why": name}]
    return document


def test_hostile_names_appear_as_text(classical):
    page = page_of(renamed(classical, HOSTILE))
    read = Reader(page)
    assert not [tag for tag, _ in read.tags if tag == "img"]
    assert not [attributes for _, attributes in read.tags if "onerror" in attributes]
    assert page.count("</script>") == 2
    assert "".join(read.text).count(HOSTILE) >= 8
    assert "49" not in [cell["bare"] for cell in read.cells]


def test_nothing_that_cannot_be_rendered_is_called_real(both, read):
    cannot = {row["environment"] for row in both["rendering"] if row["verdict"] == "cannot"}
    assert cannot == {"VE4", None}
    (first_row,) = re.findall(r"VE4 ?25000 ?25 ?(.*?)−", "".join(read.text).replace("\n", ""))
    assert first_row == "cannot be renderedcannot be rendered"
    outside = " ".join(both["summary"]["sentences"][:1])
    assert "VE4" not in outside
    assert not re.search(r"VE4[^.]* feels? real", both["summary"]["paragraph"])


def test_it_says_what_the_tolerance_covers_and_which_error_curves_have(both, read):
    text = " ".join("".join(read.text).split())
    assert "standard error of every limit of the Bayesian intervals was at most 0.1 of its" in text
    assert "endpoint" not in text
    errors = [record["error"] for record in both["boundaries"] if record["error"] is not None]
    shown = " ".join(written(max(errors), 2, "percent").split())
    assert f"pointwise curves reached up to {shown} of half the band’s width" in text


def test_what_the_gate_asked_for_is_the_run_s_own(both):
    shown = " ".join("".join(Reader(page_of(both)).text).split())
    assert "below 1.01 across" in shown
    changed = copy.deepcopy(both)
    changed["diagnostics"]["gate"] |= {"rhat_limit": 1.02, "times_needed": 5.0}
    page = Reader(page_of(changed))
    text = " ".join("".join(page.text).split())
    assert "below 1.02 across" in text
    assert "below 1.01" not in text
    cells = [cell["bare"] for cell in page.cells]
    assert {"below 1.02", "5 or more"} <= set(cells)


def test_the_thresholds_of_classical_verdicts_are_those_that_judge(both):
    document = copy.deepcopy(both)
    for row in document["verdicts"]:
        row["decision"] = 0.9
    text = " ".join("".join(Reader(page_of(document)).text).split())
    assert (
        "decides: 90 % or more is real, 3.3 % or less is not (1.7 % where it lies on both sides"
        in text
    )
    assert "is approximate and needs 3 subjects" in text


def names_of(document):
    return list(parts_of(sections_of(document)))


def test_sections_stand_in_reading_order(both):
    assert [section.name for section in sections_of(both)] == [
        "summary", "comparison", "bias", "boundaries", "display", "checks", "data", "methods",
    ]  # fmt: skip
    assert [section.name for section in sections_of(both) if not section.is_folded] == [
        "summary", "comparison",
    ]  # fmt: skip


def test_tables_of_one_row_are_pairs_of_head_and_value(both):
    document = copy.deepcopy(both)
    document["summary"] = None
    document["rendering"] = document["rendering"][:1]
    page = page_of(document)
    said = page[page.index("the damping that a rigid device needs") :].partition("</dl>")[0]
    assert "<table" not in said
    assert "<dt>Directly</dt><dd>yes</dd></div><div><dt>needs (N·s/m)</dt>" in said
    assert f'<data value="{document["rendering"][0]["margin"]}">' in said


def test_without_a_coupling_there_is_the_device_alone():
    tables = scene_of().to_dict()
    del tables["coupling"]
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    table = table[table["environment"].isin(["VE1", "VE4", "VE5"])]
    document = build_document(Study(Sessions.from_frame(table), type(scene_of())(**tables)))
    assert document["coupling"] is document["design"] is None
    skipped = {entry["what"]: entry["why"] for entry in document["skipped"]}
    assert (
        skipped["coupling: Z_h_vc, Eq. 10 and admissible couplings"]
        == "the scene has no [coupling]"
    )
    assert "rendering" in names_of(document)
    assert not {"coupling", "design"} & set(names_of(document))
    said = " ".join(document["summary"]["cautions"])
    # b_d = 5 N·s/m is less than kT/2 + b of these two.
    assert "Rendered directly, VE4 and VE5 may chatter" in said
    assert "What can be rendered with every hand" in page_of(document)


def said_of(sessions):
    """Visible text of the page of one set of sessions, without a device."""
    scene = type(scene_of())(inference={"method": "classical"})
    text = "".join(Reader(page_of(build_document(Study(sessions, scene)))).text)
    return re.sub(r"\s+", " ", text)


def test_one_environment_is_spoken_of_as_one():
    whole = read_sessions(DATASETS / "hbfd_sessions.csv").table
    one = said_of(Sessions.from_frame(whole[whole["environment"] == "VE1"]))
    assert one.count("to match 1 virtual environment, once each.") == 2
    assert re.search(r"Intervals\W+boundaries\W+were derived with percept", one)
    assert "boundaries were derived" not in one


def test_trials_sessions_and_cells_not_tried_are_told():
    whole = read_sessions(DATASETS / "hbfd_sessions.csv").table
    again = whole[whole["subject"] != whole["subject"].iloc[0]].assign(session="2", trial=2)
    again[["k_adj", "b_adj"]] *= 1.01
    said = said_of(Sessions.from_frame(pd.concat([whole.iloc[1:], again])))
    told = "in 1 to 2 trials each over 1 to 2 sessions (1 of 50 cells are empty)"
    assert said.count(f"to match 5 virtual environments, {told}.") == 2
    assert "each equal-tailed; each subject counts once, by the mean of the trials." in said
    assert "1 cell has no trial: " in said[said.index("Before you rely on it") :]


def test_priors_in_force_are_printed_with_their_meaning(both):
    """Values of the scene's that are not the default's would be printed too: they are the
    model's own."""
    rows = both["diagnostics"]["priors"]
    assert {row["prior"]: row["value"] for row in rows}["sigma_u_scale"] == 0.5
    text = "".join(Reader(page_of(both)).text)
    for row in rows:
        assert row["prior"] in text
        assert row["meaning"] in text


def without_device(**inference):
    scene = scene_of(method="both", **inference)
    tables = {
        name: table for name, table in scene.to_dict().items() if name not in ("device", "coupling")
    }
    return type(scene)(**tables)


def test_an_error_above_the_tolerance_is_said_beside_the_bayesian_numbers():
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    sessions = Sessions.from_frame(table[table["environment"] == "VE2"])
    scene = without_device(tolerance=0.0001, most_steps=200)
    document = build_document(Study(sessions, scene, store=SHARED))
    gate = document["diagnostics"]["gate"]
    assert gate["passed"]
    assert not gate["tolerance_met"]
    assert gate["error_reached"] in document["summary"]["cautions"]
    assert {row["method"] for row in document["intervals"]} == {"classical", "bayesian"}
    page = page_of(document)
    assert "are withheld" not in page
    assert "checks passed, but it missed the tolerance" in page
    assert "of its interval’s half-width (0.0001 was asked), with rank" in page
    # In the summary's cautions and in the section of the sampler.
    assert "".join(Reader(page).text).count(gate["error_reached"]) == 2


def test_a_failed_gate_withholds_the_bayesian_numbers_and_says_why():
    sessions = Sessions.from_frame(unmixed_sessions())
    document = build_document(Study(sessions, without_device(**UNMIXED), store=SHARED))
    gate = document["diagnostics"]["gate"]
    assert not gate["passed"]
    page = page_of(document)
    assert "The Bayesian numbers are withheld" in page
    text = "".join(Reader(page).text)
    for reason in gate["reasons"]:
        assert reason in text
    assert {row["method"] for row in document["intervals"]} == {"classical"}


def test_simulated_input_is_named_before_any_result(classical):
    document = copy.deepcopy(classical)
    page = page_of(document)
    document["data"]["simulated"] = False
    assert "imulated" not in page_of(document).split('id="provenance"')[0]
    assert page.index("Simulated data") < page.index("<main")
    assert "simulated subjects" in page


def test_figures_come_with_their_words(both):
    plot = Plot("A <b> title of |Z_h|", "What Z_h,vc shows.", "PHN2Zy8+", ())
    page = page_of(both, {"band": plot})
    assert "A &lt;b&gt; title of |Z<sub>h</sub>|" in page
    assert "What Z<sub>h,vc</sub> shows." in page


def test_probabilities_of_published_limits_say_what_they_assume(both):
    said = "Published limits hold no correlation: k and b vary independently here."
    assert said not in page_of(both)
    document = copy.deepcopy(both)
    document["data"]["form"] = "summary"
    assert said in page_of(document)


def test_verbs_and_nouns_are_the_study_s(classical):
    document = copy.deepcopy(classical)
    document["data"]["words"] |= {"verb": "rated", "user": "judge", "users": "judges"}
    words = words_of(document)
    assert "What judges rated, and how far off" in words
    assert "Judges rated stiffness " in words


def words_of(document):
    return " ".join("".join(Reader(page_of(document)).text).split())


def test_the_loop_is_in_words_of_the_methods(classical):
    document = copy.deepcopy(classical)
    scene = document["provenance"]["scene"]
    scene["device"] |= {"delay": 1.5, "velocity_filter": {"cutoff": 300.0, "order": 2}}
    scene["inference"]["share"] = 0.75
    words = words_of(document)
    assert (
        "The device has a mass of 1 kg, a damping of 5 N·s/m, a sampling period of 0.001 s, the"
        " average hold, a delay of 1.5 samples and a velocity filter (Butterworth, 300 rad/s,"
        " order 2). Boundaries leave the velocity filter out: k and b are as adjusted."
    ) in words
    assert "limits of a share of users hold 75 % of them with confidence 95 %" in words


@pytest.mark.parametrize(
    "noun",
    [
        "{{ cycler.__init__.__globals__.os.popen('id > owned.txt').read() }}",
        "R&D {# room",
        "<script>owned()</script>",
    ],
)
def test_the_study_s_nouns_are_values_and_never_a_template(classical, noun, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    document = copy.deepcopy(classical)
    for name in ("environment", "subject", "user"):
        document["data"]["words"] |= {name: noun, f"{name}s": f"{noun}s"}
    page = page_of(document)
    assert list(tmp_path.iterdir()) == []
    assert [cell for cell in Reader(page).text if cell == noun], "not on the page as it was written"
    assert "<script>owned" not in page


def test_the_policy_names_the_script_by_its_digest(classical):
    page = page_of(classical)
    (policy,) = (
        attributes["content"]
        for tag, attributes in Reader(page).tags
        if tag == "meta" and attributes.get("http-equiv") == "Content-Security-Policy"
    )
    script = re.search(r"<script>(.*?)</script>", page, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in policy
    assert "default-src 'none'" in policy
