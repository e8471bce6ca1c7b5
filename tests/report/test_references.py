from __future__ import annotations

import re

from percept.report.references import bibtex, cited


def test_only_what_was_used_is_cited(classical, both):
    keys = [reference.key for reference in cited(classical)]
    assert keys == ["boundaries", "percept", "meeker2017", "adams1999"]
    assert {"emcee", "terbraak2006", "vehtari2021"} <= {reference.key for reference in cited(both)}


def test_entries_are_balanced_and_have_their_fields(both):
    text = bibtex(both)
    entries = re.findall(r"@(\w+)\{(\w+),", text)
    assert [key for _, key in entries] == [reference.key for reference in cited(both)]
    depth = 0
    for letter in text:
        depth += (letter == "{") - (letter == "}")
        assert depth >= 0
    assert depth == 0
    articles = [reference for reference in cited(both) if reference.entry == "article"]
    assert all(
        {"author", "title", "journal", "year", "volume", "pages"} <= one.fields.keys() for one in articles
    )


def test_the_page_s_numbers_follow_the_list(both):
    from percept.report.page import render_page

    page = render_page(both, {}, date="2026-01-01")
    shown = [int(one) for one in re.findall(r"&nbsp;\[(\d+)\]", page)]
    assert list(dict.fromkeys(shown)) == list(range(1, len(cited(both)) + 1))
