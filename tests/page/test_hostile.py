"""Text of the user's that would be a template, a tag or a script stays text, on the page and in
files."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study, read_sessions

from .browser import Tab
from .conftest import ROOT


def attack(what):
    """Text that is a template, a tag, an attribute, a script and a formula of TeX at once."""
    return (
        f"{what}{{{{ 6*7 }}}}{{% if x %}}<script>window.owned='{what}'</script>"
        f"<img src=x onerror=\"window.owned='{what}'\">' \"onload=alert(1) & $x^2$ {{# room"
    )


SHOWN = ("room", "rooms", "person", "people", "title", "subtitle", "note", "label", "factor")


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    """Folder of a report in whose scene and data every text is an attack."""
    folder = tmp_path_factory.mktemp("hostile")
    table = pd.read_csv(ROOT / "datasets" / "hbfd_sessions.csv", dtype=str)
    table = table[table["environment"].isin(["VE1", "VE2", "VE4"])]
    right = table.assign(hand=attack("right"), session="2")
    noise = np.random.default_rng(1).lognormal(0.1, 0.2, (len(right), 2))
    for column, factors in zip(("k_adj", "b_adj"), noise.T, strict=True):
        right[column] = [
            str(float(text) * f) for text, f in zip(right[column], factors, strict=True)
        ]
    table = pd.concat([table.assign(hand=attack("left")), right])
    for name in ("subject", "environment"):
        table[name] = table[name].map(attack)
    table = table.rename(columns={"k_adj": attack("column"), "hand": attack("factor")})
    file = folder / f"{attack('file').replace('/', '')}.csv"
    table.to_csv(file, index=False)
    tables = Scene.load(ROOT / "datasets" / "hbfd.toml").to_dict()
    tables["frequency"]["points"] = 11
    tables["inference"] |= {"tolerance": 0.3}
    tables["columns"] = {"k_adj": {"name": attack("column")}}
    tables["sessions"] = {
        "exclude": [{"column": "subject", "equals": [attack("S03")], "why": attack("why")}]
    }
    tables["checks"] = {}
    tables["study"] = {
        "environment": [attack("room"), attack("rooms")],
        "subject": [attack("person"), attack("people")],
        "factor": attack("factor"),
    }
    # A window is of an environment as it is named with its level.
    tables["report"] = {name: attack(name) for name in ("title", "subtitle", "note")}
    tables["quantities"] = {
        name: {"label": attack("label"), "symbol": attack("symbol")} for name in ("k", "b")
    }
    scene = Scene(**tables)
    study = Study(read_sessions(file, scene=scene), scene)
    return study.report(folder / "out", date="2026-01-01").parent


def test_no_text_of_scene_or_data_runs_on_the_page(browser, hostile):
    tab = Tab(browser, hostile / "report.html")
    assert tab.evaluate("typeof window.owned") == "undefined"
    ours = 'img:not([src^="data:image/svg+xml;base64,"])'
    assert tab.evaluate(f"document.querySelectorAll('{ours}, [onerror], [onload]').length") == 0
    scripts = "[...document.scripts].map(s => s.id || s.type || 'page')"
    assert tab.evaluate(scripts) == ["curves", "page"]
    text = tab.evaluate("document.documentElement.textContent")
    missing = [what for what in SHOWN if attack(what) not in text]
    assert missing == []
    for environment in ("VE1", "VE2", "VE4"):
        assert attack(environment) in text
    tab.evaluate("document.querySelectorAll('details').forEach(e => { e.open = true; })")
    assert tab.evaluate("document.querySelector('#explorer').hidden") is False
    assert tab.complaints == []
    tab.page.close()


def test_figures_beside_the_page_run_nothing(browser, hostile):
    figures = sorted((hostile / "figures").glob("*.svg"))
    assert len(figures) > 4
    for figure in figures:
        tab = Tab(browser, figure)
        assert tab.evaluate("typeof window.owned") == "undefined", figure.name
        assert tab.evaluate("document.querySelectorAll('script, img').length") == 0
        assert tab.complaints == []
        tab.page.close()


def test_the_policy_lets_no_other_script_run_and_nothing_be_fetched(open_tab):
    tab = open_tab()
    tab.evaluate(
        "document.body.append(Object.assign(document.createElement('script'),"
        " {textContent: 'window.owned = 1'}))"
    )
    tab.evaluate(
        "document.body.append(Object.assign(document.createElement('img'),"
        " {src: 'https://percept.invalid/x.png'}))"
    )
    assert tab.evaluate("typeof window.owned") == "undefined"
    said = " ".join(tab.complaints)
    assert "script-src" in said
    assert "img-src" in said
