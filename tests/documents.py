"""Documents of studies, as report.json holds them."""

from percept.report import document_of


def build_document(study, **options):
    """The plain values of report.json; `options` are those of `Study.results`."""
    return document_of(study.results(**options))
