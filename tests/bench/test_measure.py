"""What a part measured, written: every column explained, full precision in the document."""

from __future__ import annotations

import dataclasses
import sys

import pytest

from percept.bench.digits import Digits
from percept.bench.growth import Growth
from percept.bench.measure import described, measurement, measurement_markdown
from percept.bench.skipping import Saving
from percept.cli import main

RECORDS = (Digits, Saving, Growth)


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
    assert page.startswith(
        "# Skipping\n\nThe cost of one scene. The studies are simulated.\n\nMade on 20"
    )
    assert " by `typed` from commit " in page
    assert " The run took 12 s on " in page
    assert "load 0.5 before and 1.5 after." in page
    assert "| device\\|hand | 0.3333 | 1 | emcee, jinja2 |  | 22 |" in page
    assert "- seconds: Processor time of the whole process, imports" in page
    assert "simulated" not in measurement_markdown(dataclasses.replace(document, part="digits"))


def test_parts_that_write_a_page_of_their_own_go_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "growth", "peers"]) == 2
    assert "value 'peers': must run alone." in capsys.readouterr().err
    assert main(["bench"]) == 2
    assert "name a part to measure: designs, digits, propagation" in capsys.readouterr().err
    assert main(["bench", "sizes"]) == 2
    said = capsys.readouterr().err
    assert "value 'sizes': no such part; they are designs, digits, propagation" in said


@pytest.mark.parametrize("asked", ["digits", "--stability"])
def test_what_is_not_installed_is_named_with_its_extra(
    asked: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mpmath", None)
    assert main(["bench", asked]) == 2
    message = "digits needs mpmath, which is not installed. Install percept with its extra"
    assert message in capsys.readouterr().err
