"""Page tests: run by ``pytest -m page``, skipped with the reason where there is no browser or
axe-core."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from percept import Scene, Study, read_sessions
from tests.fits import SHARED

from .browser import Tab, find_browser, running

ROOT = Path(__file__).parents[2]


def pytest_configure(config):
    config.addinivalue_line("markers", "page: drives a headless Chromium (run by `make test-page`)")


def pytest_collection_modifyitems(config, items):
    for item in items:
        if Path(__file__).parent not in item.path.parents:
            continue
        item.add_marker(pytest.mark.page)
        if "page" not in config.option.markexpr:
            item.add_marker(pytest.mark.skip(reason="needs a browser: run `make test-page`"))


def axe_file():
    """axe-core's script, from PERCEPT_AXE or from `npm install --prefix build axe-core`."""
    named = os.environ.get("PERCEPT_AXE")
    path = Path(named) if named else ROOT / "build" / "node_modules" / "axe-core" / "axe.min.js"
    return path if path.is_file() else None


@pytest.fixture(scope="session")
def axe():
    path = axe_file()
    if path is None:
        pytest.skip(
            "no axe-core: `npm install --prefix build axe-core`, or name axe.min.js in PERCEPT_AXE"
        )
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def browser():
    executable = find_browser()
    if executable is None:
        pytest.skip("no Chromium: `apt-get install chromium`, or name one in PERCEPT_BROWSER")
    pytest.importorskip("playwright", reason="needs the extra percept-haptics[page]")
    with running(executable) as started:
        yield started


@pytest.fixture(scope="session")
def page(tmp_path_factory):
    """Page of the published study, both methods, sampled to a loose accuracy."""
    tables = Scene.load(ROOT / "datasets" / "hbfd.toml").to_dict()
    tables["inference"] |= {"tolerance": 0.05}
    sessions = read_sessions(ROOT / "datasets" / "hbfd_sessions.csv")
    study = Study(sessions, Scene(**tables), store=SHARED)
    return study.report(tmp_path_factory.mktemp("page"), date="2026-01-01")


@pytest.fixture
def open_tab(browser, page):
    """Open the page; closed again after the test."""
    tabs = []

    def opened(**settings):
        tabs.append(Tab(browser, page, **settings))
        return tabs[-1]

    yield opened
    for tab in tabs:
        tab.page.close()
