"""What a part measured, written: every column explained, full precision in the document."""

from __future__ import annotations

import dataclasses

import pytest

from reports.benchmark.digits import Digits
from reports.benchmark.measure import described, measurement, measurement_markdown
from reports.benchmark.skipping import Saving

RECORDS = (Digits, Saving)


@pytest.mark.parametrize("record", RECORDS)
def test_every_column_is_explained(record: type) -> None:
    about, columns = described(record)
    assert about.endswith(".")
    names = [column.names for column in columns]
    assert names == [[field.name] for field in dataclasses.fields(record)]
    assert all(column.meaning.endswith(".") for column in columns)


def test_the_page_rounds_and_the_document_does_not() -> None:
    saving = Saving("device|hand", 1 / 3, 1.0, ("emcee", "jinja2"), (), 22)
    document = measurement("skipping", [saving], command="typed", loads=(0.5, 1.5), seconds=12.4)
    assert document.rows[0]["seconds"] == 1 / 3
    page = measurement_markdown(document)
    assert page.startswith("# Skipping\n\nThe cost of one scene.\n\nMade on 20")
    assert " by `typed` from commit " in page
    assert " The run took 12 s on " in page
    assert "load 0.5 before and 1.5 after." in page
    assert "| device\\|hand | 0.3333 | 1 | emcee, jinja2 |  | 22 |" in page
    assert "- seconds: Processor time of the whole process, imports" in page
