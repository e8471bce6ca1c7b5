"""What a part measured, written: every column explained, full precision in the document."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from percept.bench.classical import Coverage
from percept.bench.classical import Digits as MomentDigits
from percept.bench.density_digits import DensityDigits
from percept.bench.envelope import EnvelopeCost
from percept.bench.growth import Growth
from percept.bench.haptics import MagnitudeCost
from percept.bench.haptics_digits import Digits
from percept.bench.measurement import described, measurement, measurement_markdown
from percept.bench.propagation import PropagationCost, PropagationMemory
from percept.bench.sampling import SamplingCost
from percept.bench.skipping import Saving
from percept.bench.tolerance_digits import ToleranceDigits
from percept.bench.workers import BatchCost
from percept.cli import main

RECORDS = (
    SamplingCost, MagnitudeCost, PropagationCost, EnvelopeCost, PropagationMemory, MomentDigits,
    ToleranceDigits, DensityDigits, Coverage, Digits, Saving, BatchCost, Growth,
)  # fmt: skip


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: f"{record.__module__}.{record.__name__}")
def test_every_column_is_explained(record: type) -> None:
    about, columns = described(record)
    assert about.endswith(".")
    assert [name for names, _ in columns for name in names] == [
        field.name for field in dataclasses.fields(record)
    ]
    assert all(meaning for _, meaning in columns)


def test_the_page_rounds_and_the_document_does_not() -> None:
    saving = Saving("device|hand", 1 / 3, 0.25, 0.5, 1.0, ("emcee", "jinja2"), (), 22)
    document = measurement(
        "skipping", [saving], command="typed", simulated=True, loads=(0.5, 1.5), seconds=12.4
    )
    assert document["rows"][0]["seconds"] == 1 / 3
    page = measurement_markdown(document)
    assert page.startswith(
        "# Skipping\n\nThe cost of one scene. The studies are simulated.\n\n`typed`, 12 s on"
    )
    assert "load 0.5 before and 1.5 after; Python 3." in page
    assert "| device\\|hand | 0.3333 | 0.25 | 0.5 | 1 | emcee, jinja2 |  | 22 |" in page
    assert "- seconds, seconds_low, seconds_high: Processor time of the whole process, imports" in page
    assert "simulated" not in measurement_markdown(document | {"simulated": False})


def test_parts_are_written_as_they_are_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "of mine"
    assert main(["bench", "moments", "haptics", "--cases", "20", "--out", str(out)]) == 0
    assert capsys.readouterr().out.splitlines() == [str(out / "moments.md"), str(out / "haptics.md")]
    moments, haptics = (json.loads((out / f"{part}.json").read_text()) for part in ("moments", "haptics"))
    assert haptics["command"] == "percept bench haptics --cases 20 --out DIR"
    assert not moments["simulated"]
    assert "NumAcc4" in {row["name"] for row in moments["rows"]}
    assert (out / "moments.md").read_text().count("\n| ") == 1 + len(moments["rows"])


def test_parts_are_written_and_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "moments", "--json", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    written = json.loads((tmp_path / "moments.json").read_text())
    assert json.loads(printed.out)["moments"] == written["rows"]
    assert printed.err.splitlines()[-1] == str(tmp_path / "moments.md")


def test_parts_that_write_a_page_of_their_own_go_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "moments", "peers"]) == 2
    assert "value 'peers': not a part that goes with others; those are " in capsys.readouterr().err
