"""Numbers of the page lead back to report.json."""

import dataclasses
import json

import pytest

from percept.report.overview import findings
from percept.report.page import Places
from percept.results import SourceFile
from tests.documents import EMPTY, at


@pytest.fixture(scope="module")
def results():
    """Results with two equal files, and a name that a pointer has to escape."""
    files = (SourceFile("a.csv", "00", 3), SourceFile("a.csv", "00", 3))
    provenance = dataclasses.replace(EMPTY.provenance, seed=7, files=files)
    counts = {"rows/read~": 12}
    return dataclasses.replace(
        EMPTY, provenance=provenance, data=dataclasses.replace(EMPTY.data, counts=counts)
    )


def test_what_a_pointer_leads_to_is_the_value(results):
    found = findings(results)
    document = json.loads(results.to_json(found))
    places = Places(results, found)
    for record, *steps in (
        (results.provenance, "seed"),
        (results.data.counts, "rows/read~"),
        (results.data.words, "subject", 1),
        (found, "cautions", 0),
    ):
        pointer = places.pointer(record, *steps)
        if steps[0] != "cautions":
            assert at(document, pointer) == places.value(record, *steps)
    assert places.pointer(found, "cautions", 0) == "/summary/cautions/0"


def test_a_key_that_a_table_lacks_has_no_value_and_a_record_is_known_by_its_place(results):
    places = Places(results, findings(results))
    assert places.value(results.data.counts, "rows left") is None
    with pytest.raises(AttributeError, match="rows_left"):
        places.value(results.data, "rows_left")
    with pytest.raises(KeyError):
        places.pointer(SourceFile("a.csv", "00", 3), "rows")
