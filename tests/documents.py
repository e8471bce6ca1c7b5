"""Documents of studies, tables row by row, and pages of documents that were changed."""

import json
from functools import cache

from pydantic import TypeAdapter

from percept.report.overview import findings
from percept.report.write import build_sections, render_page
from percept.results import Data, Provenance, Results, Words
from percept.results.results import read_rows
from percept.sessions.quantities import IMPEDANCE

#: Results of a study of stiffness that has nothing yet.
EMPTY = Results(
    provenance=Provenance({}, 1, (), {"inference": {"family": "lognormal"}}),
    data=Data(
        form="trials", simulated=False, subjects=4, rows=4, environments=(), parameters=("k",),
        quantities={"k": IMPEDANCE["k"]}, counts={}, notices=(), references=1,
        words=Words("environment", "environments", "subject", "subjects", "user", "users"),
        doubts=(), exclusions=(), design=None, cells=(),
    ),
    intervals=(), contrast=(), boundaries=(), verdicts=(), rendering=None,
    coupling=None, band=None, design=None, sensitivity=None, comparison=None,
    band_pairs=None, ladder=None, diagnostics=None, checks=None, skipped=(),
)  # fmt: skip


def build_document(study, **options):
    """The plain values of report.json; `options` are those of `Study.results`."""
    results = study.results(**options)
    return with_rows(results.to_json(findings(results)))


def with_rows(text):
    """The plain values of report.json's text."""
    document = json.loads(text)
    read_rows(document)
    return document


@cache
def _schema():
    return TypeAdapter(Results)


def as_results(document):
    """The records that a document holds, as `Results.load` reads them."""
    return _schema().validate_python(document)


def page_of(document, plots=None, *, date="2026-01-01"):
    """The page of a document."""
    return page_of_results(as_results(document), plots, date=date)


def page_of_results(results, plots=None, *, date="2026-01-01", files=()):
    """The page of results."""
    found = findings(results)
    sections = build_sections(results, found)
    return render_page(results, sections, plots or {}, date=date, files=files)


def sections_of(document):
    """The sections of a document's page."""
    results = as_results(document)
    sections = build_sections(results, findings(results))
    return [section for section in sections if section.filled]


def parts_of(sections):
    """Every section and part with something in it, by name."""
    found = {}
    for section in sections:
        if section.filled:
            found[section.name] = section
            found |= parts_of(section.parts)
    return found
