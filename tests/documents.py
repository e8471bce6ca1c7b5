"""Documents of studies, as report.json holds them."""

from pydantic import TypeAdapter

from percept.report import document_of
from percept.results import Results


def build_document(study, **options):
    """The plain values of report.json; `options` are those of `Study.results`."""
    return document_of(study.results(**options))


def as_results(document):
    """The records that a document holds, as `Results.load` reads them."""
    return TypeAdapter(Results).validate_python(document)
